from experiments.measured_arm.run import main

main()
