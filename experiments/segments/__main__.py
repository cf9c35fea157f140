from experiments.segments.run import main

main()
