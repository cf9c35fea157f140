from experiments.live_page.run import main

main()
