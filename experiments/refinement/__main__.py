from experiments.refinement.run import main

main()
