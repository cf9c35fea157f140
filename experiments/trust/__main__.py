from experiments.trust.run import main

main()
