"""A headless Chromium, driven by the DevTools protocol through websockets, which viser brings along."""

import base64
import itertools
import json
import subprocess
import time
import urllib.request
from contextlib import suppress
from pathlib import Path

from chromium import CHROMIUM

OPTIONS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--no-first-run", "--mute-audio"),
    *("--disable-background-networking", "--disable-extensions", "--remote-debugging-port=0", "--hide-scrollbars"),
)


class Browser:
    """One process of Chromium with one tab for each page that is opened."""

    def __init__(self, folder, size=(1280, 800)):
        self._folder = Path(folder)
        command = [CHROMIUM, *OPTIONS, f"--window-size={size[0]},{size[1]}", f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._tabs = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for tab in self._tabs:
            with suppress(Exception):
                tab.close()
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(10)
            return
        self._process.kill()

    def open(self, url):
        """A new tab with a page."""
        port = until(lambda: (self._folder / "DevToolsActivePort").read_text().split()[0], seconds=30)
        ask = urllib.request.Request(f"http://127.0.0.1:{port}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(ask) as answer:
            tab = Tab(json.load(answer)["webSocketDebuggerUrl"])
        self._tabs.append(tab)
        tab.call("Page.enable")
        tab.call("Runtime.enable")
        tab.call("Page.navigate", url=url)
        return tab


class Tab:
    """One page."""

    def __init__(self, address):
        from websockets.sync.client import connect

        self._socket = connect(address, max_size=None, open_timeout=30)
        self._numbers = itertools.count(1)
        self.errors = []

    def call(self, method, **parameters):
        """A command of the protocol, and its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=30))
            if message.get("method") == "Runtime.exceptionThrown":
                self.errors.append(message["params"]["exceptionDetails"])
            if message.get("id") == number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]

    def value(self, script):
        """What a script in the page gives."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"])[:500])
        return found["result"].get("value")

    def text(self):
        """All words of the page."""
        return self.value("document.body.innerText")

    def picture(self, path):
        """A screenshot as PNG."""
        found = self.call("Page.captureScreenshot", format="png")
        Path(path).write_bytes(base64.b64decode(found["data"]))

    def click(self, x, y):
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def drag(self, start, end, steps=6):
        """Press at one place, move, and release at another."""
        (x, y), (to_x, to_y) = start, end
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", clickCount=1)
        for step in range(1, steps + 1):
            share = step / steps
            here = {"x": x + share * (to_x - x), "y": y + share * (to_y - y)}
            self.call("Input.dispatchMouseEvent", type="mouseMoved", button="left", buttons=1, **here)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=to_x, y=to_y, button="left", clickCount=1)

    def press(self, label):
        """Click the button of this label."""
        x, y = self.value(
            f"""(() => {{
                const label = {json.dumps(label)};
                const found = [...document.querySelectorAll('button')].find(b => b.innerText.trim() === label);
                found.scrollIntoView({{block: 'center'}});
                const box = found.getBoundingClientRect();
                return [box.x + box.width / 2, box.y + box.height / 2];
            }})()"""
        )
        self.click(x, y)

    def slide(self, label, share):
        """Drag the thumb of the first slider of this label to a share of its track."""
        found = self.value(
            f"""(() => {{
                const label = {json.dumps(label)};
                const words = [...document.querySelectorAll('label')].find(l => l.innerText.trim() === label);
                let row = words;
                while (!row.querySelector('[role=slider]')) row = row.parentElement;
                row.scrollIntoView({{block: 'center'}});
                const thumb = row.querySelector('[role=slider]').getBoundingClientRect();
                const track = row.querySelector('.mantine-Slider-trackContainer').getBoundingClientRect();
                return [thumb.x + thumb.width / 2, thumb.y + thumb.height / 2, track.x, track.width];
            }})()"""
        )
        x, y, start, width = found
        self.drag((x, y), (start + share * width, y))

    def close(self):
        self._socket.close()


def until(work, seconds=15.0, pause=0.05):
    """What some work gives once it is true; what it raises on the way is passed over."""
    end = time.monotonic() + seconds
    while True:
        failure = None
        try:
            found = work()
            if found:
                return found
        except Exception as error:
            failure = error
        if time.monotonic() > end:
            raise AssertionError(f"nothing came within {seconds} s") from failure
        time.sleep(pause)
