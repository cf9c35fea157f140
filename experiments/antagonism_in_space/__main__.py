from experiments.antagonism_in_space.run import main

main()
