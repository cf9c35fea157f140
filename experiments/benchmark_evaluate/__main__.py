import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # two threads on a shared machine: waiting must not spin

from experiments.benchmark_evaluate.run import main

main()
