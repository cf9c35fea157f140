"""The live page: one arm on one task, which answer while a person moves sliders.

A page is a `State`, plain numbers that every event turns into another one. `answer` evaluates it, `draw` says what
there is to see, `controls` what there is to move; none of these know of a server or a browser. `Session` does that for
one browser, newest state first; `server` shows it with viser, and `Framing` sees to it that all of it is in view.
"""
