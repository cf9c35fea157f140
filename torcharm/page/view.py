"""The page of one browser: its controls, its scene and its words, kept as the newest answer is."""

import math
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from torcharm.page import words
from torcharm.page.answers import Answer
from torcharm.page.charts import Charts
from torcharm.page.controls import Control, controls, same_controls
from torcharm.page.framing import Framing, shape_of
from torcharm.page.gizmo import LOAD, NOTHING, TIP, Gizmo
from torcharm.page.saving import load, save
from torcharm.page.scene import Scene, draw
from torcharm.page.session import Session
from torcharm.page.state import State

CLOSE = 1e-9
"""A difference of a control's value that is rounding, and as a share of it."""
WIDTH = 340
"""Of the panel of results [pixels]."""
LAST = 1e9
"""The order of what stands below all else, also below what is built anew."""
WIDE, LEAST = 1.5, 1150
"""From which width over height and which width [pixels] on a window has room for a panel at each side of the arm."""


class View:
    """What one browser shows: results at the left, the arm, and what there is to move at the right.

    The page begins with a state, and `out` is the one file that it writes and reads.
    """

    def __init__(self, client: Any, viser: Any, state: State, out: Path) -> None:
        self._client, self._viser, self._out = client, viser, out
        self._parts: dict[str, tuple[str, Any]] = {}  # of the scene, by name
        self._built: State | None = None
        self._roots: list[Any] = []
        self._inputs: dict[str, tuple[Control, Any]] = {}
        self._applied: dict[str, Any] = {}
        panel = client.gui.add_panel()
        with (tab := panel.add_tab("Results")):
            self._results, self._note = client.gui.add_html(""), client.gui.add_html("")
            client.gui.add_html(words.legend())
            client.gui.add_html(words.explanation(state.study.settings), order=LAST)
        client.gui.main_panel.dock_right()
        if shape_of(client.camera) >= WIDE and client.camera.image_width >= LEAST:
            panel.dock_left()
            panel.set_width(WIDTH)
        else:
            panel.dock_above(client.gui.main_panel)
        panel.expand()  # on a telephone it would be closed
        self._tab = tab
        self.session = Session(state, self._show, self._tell)
        self._gizmo = Gizmo(client.scene, viser.transforms, self.session)
        self._framing = Framing(client.camera, self.session.refresh)
        self.session.start()

    def end(self) -> None:
        """Say that the server ends, and do nothing any more. A browser keeps what it shows, dimmed."""
        self.session.close()
        self._results.content = words.ended()
        self._client.flush()

    def _show(self, found: Answer) -> None:
        scene = draw(found)
        with self._client.atomic():
            if self._built is None or not same_controls(found.state, self._built):
                self._build(found.state)
            self._draw(scene)
            self._framing.show(scene, found.arm.dimension, self._gizmo.dragging)
            self._gizmo.show(found)
            self._results.content = words.results(found)
            self._charts.show(found)
            self._set_inputs(found.state)
        self._client.flush()

    def _draw(self, scene: Scene) -> None:
        """Add what is new, change what is other than before, remove the rest."""
        for name, (adder, handle) in tuple(self._parts.items()):
            if name not in scene or scene[name].adder != adder:
                del self._parts[name]
                handle.remove()
        for name, element in scene.items():
            if name in self._parts:
                for key, value in element.properties.items():
                    setattr(self._parts[name][1], key, value)  # sends nothing where the value is as before
            else:
                handle = getattr(self._client.scene, element.adder)(f"/{name}", **element.properties, **element.fixed)
                self._parts[name] = element.adder, handle

    def _tell(self, text: str) -> None:
        self._note.content = words.note(text)

    def _build(self, state: State) -> None:
        """All controls of an arm and a task, in place of those before, and a view of that arm."""
        for root in self._roots:
            root.remove()
        gui, self._built = self._client.gui, state
        self._roots, self._inputs, self._applied = [], {}, {}
        folders: dict[tuple[str, ...], Any] = {}
        for control in controls(state):
            self._add(control, state, self._folder(control.folders, folders))
        with folders[("Task",)]:
            self._add_handle()
        with folders[("Node",)]:
            self._charts = Charts(gui, self._viser.uplot, state.named_arm.design.dimension)
        with self._folder(("Study",), folders):
            self._add_buttons()
        self._framing.begin()

    def _folder(self, path: tuple[str, ...], folders: dict[tuple[str, ...], Any]) -> Any:
        """The folder of some names, from the outermost on, which is made where there is none."""
        if path not in folders:
            within = self._folder(path[:-1], folders) if len(path) > 1 else nullcontext()
            with self._tab if path == ("Node",) else within:  # beside the results that it belongs to
                folders[path] = self._client.gui.add_folder(path[-1])
            self._roots += [folders[path]] if len(path) == 1 else []
        return folders[path]

    def _add(self, control: Control, state: State, folder: Any) -> None:
        """The input of one control, and what it does."""
        gui, value = self._client.gui, control.value(state)
        how = {"hint": control.hint or None, "disabled": not control.enabled(state)}
        with folder:
            if control.options:
                handle = gui.add_dropdown(control.label, control.options, initial_value=value, **how)
            elif control.ends is None:
                handle = gui.add_checkbox(control.label, value, **how)
            else:
                low, high = control.ends
                handle = gui.add_slider(control.label, low, high, control.step, min(max(value, low), high), **how)
        self._inputs[control.key] = control, handle
        self._applied[control.key] = value

        async def moved(event: Any) -> None:  # on the event loop, so that moves keep their order
            if event.client is not None:  # else it was set here
                self.session.move(control.key, partial(self._written, control, state, handle.value))

        handle.on_update(moved)

    def _written(self, control: Control, built: State, value: Any, state: State) -> State:
        """The state after a control was moved in the browser, which shows the value that it was moved to.

        A control of another arm or task, which the browser has not yet seen go, moves nothing.
        """
        if not same_controls(state, built):
            return state
        self._applied[control.key] = value
        if told := control.beyond(value):
            self._tell(told)
        return control.moved(state, value)

    def _set_inputs(self, state: State) -> None:
        """Bring the browser's controls to what the state says, where they are not."""
        for key, (control, handle) in self._inputs.items():
            value = control.value(state)
            last = self._applied[key]
            if value != last and not (control.ends and math.isclose(value, last, rel_tol=CLOSE, abs_tol=CLOSE)):
                self._applied[key] = value
                handle.value = value
            handle.disabled = not control.enabled(state)

    def _add_handle(self) -> None:
        self._gizmo.take(NOTHING)
        hint = "A handle in the picture moves it; the shape follows a tip."
        choice = self._client.gui.add_dropdown("drag", (NOTHING, TIP, LOAD), initial_value=NOTHING, hint=hint)

        async def chosen(event: Any) -> None:
            self._gizmo.take(choice.value)

        choice.on_update(chosen)
        hint = "Through this tip, one that the arm can hold: as torcharm plan."
        self._button("plan a shape", hint, self.session.plan)
        hint = "Where the tip can be under this load, over all pressures."
        self._button("show the workspace", hint, self.session.sweep)

    def _add_buttons(self) -> None:
        self._button("fit the view", "So that all of the arm is seen.", self._fit)
        self._button("save the study", f"To {self._out}.", self._save)
        self._button("load what was saved", f"From {self._out}.", self._load)
        self._button("undo", "The last change.", self.session.undo)
        self._button("reset", "Arm, task and load as the study has them.", self.session.reset)

    def _button(self, label: str, hint: str, work: Callable[[], None]) -> None:
        async def clicked(event: Any) -> None:
            work()

        self._client.gui.add_button(label, hint=hint).on_click(clicked)

    def _fit(self) -> None:
        self._framing.begin()
        self.session.refresh()

    def _save(self) -> None:
        """In the session's thread, when all that was moved before is in the state."""

        def write(state: State) -> State:
            try:
                save(state, self._out)
            except OSError as error:
                raise ValueError(f"{self._out}: cannot be written: {error.strerror or error}") from None
            self._tell(f"Saved to {self._out}.")
            return state

        self.session.move("save", write)

    def _load(self) -> None:
        def read(state: State) -> State:
            found = load(state, self._out)
            self._tell(f"Loaded {self._out}.")
            return found

        self.session.move("load study", read)
