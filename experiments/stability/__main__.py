from experiments.stability.run import main

main()
