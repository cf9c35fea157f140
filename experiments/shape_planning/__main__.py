from experiments.shape_planning.run import main

main()
