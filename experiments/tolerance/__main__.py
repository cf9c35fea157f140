from experiments.tolerance.run import main

main()
