import os

# numpy wakes its threads for every small problem
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from experiments.exactness.run import main

if __name__ == "__main__":
    main()
