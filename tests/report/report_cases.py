"""A study whose names would break a page that does not escape them, and what a page holds."""

from collections import Counter
from html.parser import HTMLParser

SCRIPT, IMAGE = "<script>alert(1)</script>", '"><img src=x onerror=alert(1)>'
TEMPLATE, UNICODE = "{{7*7}} {%raw%} ]]> --> $\\frac{$ =1+1 &amp;", "„Ärmchen 腕“ عربي"
SERIES = "two in series"
NAMES = (UNICODE, SCRIPT, IMAGE, TEMPLATE, SERIES)
TASK = "</title></style></textarea><b>bend</b>"

STUDY = f"""
name = '''{UNICODE} {SCRIPT}'''
description = "bell \\u0007, null \\u0000, a half \\u007f, {{{{7*7}}}} <iframe src=//example.org></iframe>"
[[arm]]
name = '''{UNICODE}'''
kind = "antagonistic"
[[arm]]
name = '''{SCRIPT}'''
kind = "bellows"
[[arm]]
name = '''{IMAGE}'''
kind = "mckibben"
outer_radius = 0.05
[[arm]]
name = '''{TEMPLATE}'''
kind = "antagonistic"
outer_radius = 0.05
mass = 0.2
[[arm]]
name = "{SERIES}"
[[arm.segment]]
radii = [-0.05, -0.015, 0.015, 0.05]
actuators = ["bellows", "mckibben", "mckibben", "bellows"]
length = 0.25
[[arm.segment]]
radii = [-0.05, -0.015, 0.015, 0.05]
actuators = ["bellows", "mckibben", "mckibben", "bellows"]
length = 0.25
[[task]]
name = '''{TASK}'''
arms = ['''{UNICODE}''', '''{SCRIPT}''', '''{IMAGE}''', '''{TEMPLATE}''']
shape = {{ kind = "affine", slope = 0.0, intercept = 1.0, length = 0.5, nodes = 10 }}
loads = {{ count = 43, scale = [4, 4, 0.4], seed = 100 }}
[[task]]
name = "degrees"
arms = ['''{SCRIPT}''']
shape = {{ kind = "affine", slope = 0.0, intercept = 12.0, length = 0.5, nodes = 10 }}
[[task]]
name = "S"
arms = ["{SERIES}"]
gravity = true
shape = [
  {{ kind = "constant", curvature = 0.4, length = 0.25, nodes = 5 }},
  {{ kind = "constant", curvature = -0.4, length = 0.25, nodes = 5 }},
]
loads = {{ count = 43, scale = [2, 2, 0.2], seed = 100 }}
"""
"""Five designs, in the plane and in series, on 43 loads each; one task is impossible, some loads are undecided."""


class Page(HTMLParser):
    """The elements, attributes and words of a page."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags, self.attributes, self.words, self.textareas = Counter(), [], [], []
        self._open = []
        self.feed(text)
        self.close()
        self.textareas = [text.removeprefix("\n") for text in self.textareas]  # as browsers do

    def handle_starttag(self, tag, attributes):
        self.tags[tag] += 1
        self.attributes += [(tag, *attribute) for attribute in attributes]
        self._open.append(tag)
        if tag == "textarea":
            self.textareas.append("")

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data):
        if self._open[-1:] == ["textarea"]:
            self.textareas[-1] += data
        elif self._open[-1:] not in (["script"], ["style"]):
            self.words.append(data)

    def values(self, name):
        """Of an attribute, wherever it is."""
        return [value for _, own, value in self.attributes if own == name]
