from experiments.workspace.run import main

main()
