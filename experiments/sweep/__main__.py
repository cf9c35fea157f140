from experiments.sweep.run import main

main()
