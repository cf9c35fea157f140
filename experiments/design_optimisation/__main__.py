from experiments.design_optimisation.run import main

main()
