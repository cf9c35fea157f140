from experiments.characterisation.run import main

main()
