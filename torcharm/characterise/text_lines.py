"""The lines of a text file, in whatever encoding and with whatever ends of lines."""

import re


def text_lines(source: str, data: bytes) -> tuple[list[str], bool]:
    """A file's lines by any ending, and whether the last one is ended."""
    wide = _utf16(data)
    if wide:
        text = data.decode(wide, errors="replace")
    elif b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise ValueError(f"{source}: line {line}: must be text, as CSV is, got a byte 0, as of a program's own format")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
    # CR, CR LF and the loggers' CR CR LF end one line each.
    text = re.sub("\r+\n?", "\n", text) if "\r" in text else text
    if text[:1] == "{":  # an object of JSON in each line
        text = re.sub('[{}"]', "", text)
    lines = text.split("\n")
    ended = not lines[-1].strip()
    return lines[:-1] if lines[-1] == "" else lines, ended


def _utf16(data: bytes) -> str:
    """Which UTF-16 a file is in, by its mark or, without one, by the zeros of plain letters; "" for none."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    even, odd = data[:2000:2], data[1:2000:2]
    if len(odd) > 4 and odd.count(0) > 0.8 * len(odd) and not even.count(0):
        return "utf-16-le"
    return "utf-16-be" if len(odd) > 4 and even.count(0) > 0.8 * len(even) and not odd.count(0) else ""
