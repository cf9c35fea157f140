from experiments.antagonism.run import main

main()
