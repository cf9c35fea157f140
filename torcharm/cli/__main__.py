"""`python -m torcharm.cli`."""

from torcharm.cli import main

main()
