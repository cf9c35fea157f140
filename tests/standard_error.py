"""What commands write to the standard error."""

import re


def without_notice(text: str) -> str:
    """The text without the line that the first command of all writes, as it compiles the engine."""
    return re.sub(r"torcharm: compiling, once: about \d+ s\n", "", text)
