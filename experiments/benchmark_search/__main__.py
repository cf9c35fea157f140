import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # threads on a shared machine: waiting must not spin

from experiments.benchmark_search.run import main

main()
