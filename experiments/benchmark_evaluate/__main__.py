from experiments.benchmark_evaluate.run import main

main()
