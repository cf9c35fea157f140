"""The handle of a scene, by stand-ins for viser's."""

import threading
from types import SimpleNamespace

import pytest
from page_cases import plane

from torcharm.page.answers import answer
from torcharm.page.gizmo import LOAD, TIP, Gizmo
from torcharm.page.session import Session


def test_what_is_taken_while_the_handle_is_being_shown_waits_for_that():
    """The server's thread hears of another choice while the session's shows an answer."""
    transforms = pytest.importorskip("viser.transforms", reason="needs torcharm[explore]")
    taken, handles = threading.Event(), []

    def add(*_, **__):
        handles.append(SimpleNamespace(on_update=lambda _: other.start() or taken.wait(0.2), remove=taken.set))
        return handles[-1]

    session = Session(plane(), lambda _: None, lambda _: None)
    gizmo = Gizmo(SimpleNamespace(add_transform_controls=add), transforms, session)
    other = threading.Thread(target=gizmo.take, args=(LOAD,))
    gizmo.take(TIP)
    gizmo.show(answer(plane()))
    other.join()
    assert taken.is_set()
    assert handles[0].wxyz is not None
