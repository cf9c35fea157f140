from experiments.benchmark_search.run import main

main()
