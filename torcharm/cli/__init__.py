"""The `torcharm` command."""

import sys


def main() -> None:
    """Run the command and exit: 0, or 2 after a mistake, or 130 after Ctrl-C, which may come while all is imported."""
    try:
        from torcharm.cli.app import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        from torcharm.cli.terminal import INTERRUPTED, fail

        fail("interrupted", INTERRUPTED)
    sys.exit(code)
