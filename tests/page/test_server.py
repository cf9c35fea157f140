"""Pages over the socket, as browsers meet them: each has its own, follows its controls, and is never stale."""

import contextlib
import random

import pytest
from page_cases import HOSTILE, PLANE, SPACE

pytest.importorskip("viser", reason="needs torcharm[explore]")

from experiments.live_page.run import at_random, burst, page_of, settled, stale, timed
from experiments.live_page.socket import Page
from torcharm.page import state as page_state
from torcharm.page.server import PORTS, Server, own_origin
from torcharm.study import parse_study


@contextlib.contextmanager
def served(folder, text=PLANE):
    server = Server(page_state.opened(parse_study(text)), folder / "saved.toml", port=0)
    try:
        yield server
    finally:
        server.stop()


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
def test_nothing_is_stale_after_events_at_random(tmp_path, text, capfd):
    with served(tmp_path, text) as server, page_of(server) as page:
        assert at_random(server, page, 100) == []
        (view,) = server.views.values()
        assert view.session.failures == 0
        assert "Traceback" not in capfd.readouterr().err
        assert sorted(path.name for path in tmp_path.iterdir()) in ([], ["saved.toml"])


def test_a_burst_is_not_queued_and_each_move_has_its_picture(tmp_path):
    with served(tmp_path) as server, page_of(server) as page:
        draw_random = random.Random(0)
        times = timed(page, 10, draw_random)
        assert len(times) == 10
        pictures, _ = burst(server, page, draw_random)
        assert 1 <= pictures < 20
        assert stale(server, page) == []


def test_two_pages_are_each_their_own(tmp_path):
    with served(tmp_path) as server, page_of(server) as one:
        with Page(server.url) as other:
            other.until(lambda: other.pictures)
            first, second = (server.views[number].session for number in sorted(server.views))
            one.move(one.find("length [mm]"), 600.0)
            other.move(other.find("limit [kPa]"), 20.0)
            one.until(lambda: first.state.designs[0][0].length == 0.6)
            other.until(lambda: second.state.designs[0][0].limit == 20.0)
            assert second.state.designs[0][0].length == 0.5
            assert first.state.designs[0][0].limit == 50.0
            other.move(other.find("arm"), f"other {HOSTILE}")
            other.until(lambda: second.state.arm == 1)
            assert first.state.arm == 0
        one.until(lambda: len(server.views) == 1)
        settled(server, one)
        assert stale(server, one) == []


def test_the_handles_move_the_tip_and_the_load_and_undo_takes_it_back(tmp_path):
    with served(tmp_path) as server, page_of(server) as page:
        (view,) = server.views.values()
        session, before = view.session, view.session.state
        page.move(page.find("drag"), "the load")
        page.until(lambda: "/handle" in page.scene)
        page.drag("/handle", [0.3, -0.4, 0.0])
        page.until(lambda: session.state.tip != before.tip)
        settled(server, page)
        force = page.controls[page.find("force x [N]")].value
        assert force == pytest.approx(session.state.tip[0], abs=0.01)
        page.press("undo")
        page.until(lambda: session.state.tip == before.tip)
        page.move(page.find("drag"), "the tip")
        settled(server, page)
        page.drag("/handle", [0.15, -0.4, 0.0], [0.9689, 0.0, 0.0, -0.2474])
        page.until(lambda: session.state.twists is not None)
        settled(server, page)
        assert stale(server, page) == []


def test_names_are_words_and_buttons_write_the_one_file(tmp_path):
    with served(tmp_path) as server, page_of(server) as page:
        assert "<img" not in page.words
        assert page.controls[page.find("arm")].value == f"mine {HOSTILE}"
        page.press("load what was saved")
        page.until(lambda: "cannot be read" in page.words)
        page.press("save the study")
        page.until(lambda: "Saved to" in page.words)
        page.move(page.find("arm"), "../../elsewhere")  # no arm
        page.move(page.find("task"), "/etc/passwd")
        page.move(page.find("length [mm]"), "../../x")
        page.move(page.find("limit [kPa]"), [1, {}])
        settled(server, page)
        assert [path.name for path in tmp_path.iterdir()] == ["saved.toml"]
        assert stale(server, page) == []
        assert next(iter(server.views.values())).session.failures == 0
        page.move(page.find("limit [kPa]"), 1e4)
        page.until(lambda: "limit [kPa]: goes from 5 to 75 on this page" in page.words)


def test_a_port_that_is_taken_is_left_and_none_at_all_is_told(tmp_path, monkeypatch):
    with served(tmp_path) as first:
        second = Server(page_state.opened(parse_study(PLANE)), tmp_path / "saved.toml", port=first.port)
        second.stop()
        assert first.port < second.port < first.port + PORTS
        monkeypatch.setattr("torcharm.page.server.PORTS", 1)
        with pytest.raises(ValueError, match=rf"--port: must be one at which .* got {first.port} \(.*in use"):
            Server(page_state.opened(parse_study(PLANE)), tmp_path / "saved.toml", port=first.port)


def test_pages_of_other_sites_get_nothing(tmp_path):
    with served(tmp_path) as server, Page(server.url, origin="http://evil.example") as page:
        for _ in range(10):
            page.receive(0.1)
        assert not server.views
        assert page.pictures == 0
        page.send({"type": "ShareUrlRequest"})  # viser would ask a server elsewhere to forward the page
        page.receive(0.3)
        assert server._server._share_tunnel is None


@pytest.mark.parametrize(
    ("origin", "asked", "host", "own"),
    [
        ("http://localhost:8080", "localhost:8080", "127.0.0.1", True),
        ("http://127.0.0.1:9", "127.0.0.1:8080", "127.0.0.1", True),  # forwarded to another port
        ("http://evil.example", "localhost:8080", "127.0.0.1", False),
        ("http://evil.example:8080", "evil.example:8080", "127.0.0.1", False),  # whose name points here
        ("http://robot.lan:8080", "robot.lan:8080", "0.0.0.0", True),
        ("http://evil.example", "robot.lan:8080", "0.0.0.0", False),
        ("null", "localhost:8080", "127.0.0.1", False),
        ("http://[", "localhost:8080", "127.0.0.1", False),
    ],
)
def test_a_page_is_the_server_s_own_or_not(origin, asked, host, own):
    assert own_origin(origin, asked, host) is own
