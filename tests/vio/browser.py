"""A Chromium without a window that shows pages one after the other (DevTools over a pipe)."""

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import time

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
WORDS = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
         "--remote-debugging-pipe"]  # fmt: skip
# Chromium reads commands on descriptor 3 and answers on 4.
AS_3_AND_4 = (
    "import os, sys; a, b = map(int, sys.argv[1:3]); os.dup2(a, 3); os.dup2(b, 4);"
    " os.execv(sys.argv[3], sys.argv[3:])"
)
TIMEOUT_S = 120.0


class Browser:
    """One process and one page in it; `errors`: what its scripts and its console complain of."""

    def __init__(self, profile):
        (theirs_in, self._to), (self._from, theirs_out) = os.pipe(), os.pipe()
        # beyond 3 and 4, so that neither is overwritten before it is moved there
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (theirs_in, theirs_out)]
        starter = [sys.executable, "-c", AS_3_AND_4, *map(str, ends)]
        self._process = subprocess.Popen(
            [*starter, BROWSER, *WORDS, f"--user-data-dir={profile}"],
            pass_fds=ends, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        for end in (theirs_in, theirs_out, *ends):
            os.close(end)
        self._rest, self._number, self._session, self._loaded = b"", 0, None, False
        self.errors = []
        target = self("Target.createTarget", url="about:blank")["targetId"]
        opened = self("Target.attachToTarget", targetId=target, flatten=True)
        self._session = opened["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self(f"{domain}.enable")

    def __call__(self, method, **params):
        """The result of a command of the DevTools protocol."""
        self._number += 1
        number, message = self._number, {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != number:
            self._note(answer)
        assert "error" not in answer, f"{method}: {answer}"
        return answer["result"]

    def show(self, page, width, scheme):
        """Load a page in a window of a width, for readers who prefer light or dark."""
        self.prefer(scheme)
        self("Emulation.setDeviceMetricsOverride", width=width, height=2400, deviceScaleFactor=1,
             mobile=False)  # fmt: skip
        self.errors.clear()
        self._loaded = False
        self("Page.navigate", url=page.as_uri())
        while not self._loaded:
            self._note(self._next())

    def prefer(self, scheme):
        """light or dark, from now on."""
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self("Emulation.setEmulatedMedia", features=[feature])

    def evaluate(self, script):
        """What a script comes to in the page; a promise is awaited."""
        done = self("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in done, done
        return done["result"]["value"]

    def screenshot(self):
        """The window as PNG."""
        return base64.b64decode(self("Page.captureScreenshot")["data"])

    def close(self):
        self("Browser.close")
        self._process.wait(timeout=TIMEOUT_S)
        os.close(self._to)
        os.close(self._from)

    def _next(self):
        end = time.monotonic() + TIMEOUT_S
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._from], [], [], max(0.0, end - time.monotonic()))
            data = os.read(self._from, 1 << 20) if ready else b""
            assert data, "the browser fell silent"
            self._rest += data
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def _note(self, event):
        what, params = event.get("method"), event.get("params", {})
        self._loaded |= what == "Page.loadEventFired"
        if what == "Runtime.exceptionThrown":
            self.errors.append(params["exceptionDetails"])
        elif what == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        elif what == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.errors.append(params["args"])
