"""A drive in the viewer Rerun: the recording, and what its web viewer shows in Chromium."""

import io
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from ampc_msgs_config.nodes.derived_topics import DerivedTopics
from ampc_msgs_config.nodes.scene import CAR_COLOUR
from ampc_msgs_config.recording.bag_writer import Recording
from launch_scripts import report
from launch_scripts.bags.bag import open_bag
from launch_scripts.reporting import rerun_file
from launch_scripts.reporting.rerun_file import DRIVEN_RGB, REFERENCE_RGB
from tests.html_pages import CHROMIUM, open_browser
from tests.recorded_drives import drive_in_real_time
from tests.waiting import TIMEOUT

SOFTWARE_GL = (
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--no-first-run", "--disable-background-networking"),
)
SIZE = {"width": 1400, "height": 800}
TOLERANCE = 40
"""Largest difference of each of red, green and blue: lines have smooth edges."""
MOST_NOISE = 30
"""Pixels of a colour that do not count as something drawn."""
Picture = NDArray[np.int64]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the bag of a drive, with the topics that a recorder derives."""
    folder = tmp_path_factory.mktemp("drive")
    drive_in_real_time(folder / "received", lambda *_: None)
    derived = DerivedTopics("paper", -1.0, "", transforms=True, pictures=True)
    with open_bag(folder / "received") as old, Recording(folder / "bag") as new:
        for each in old.messages(old.topics):
            rows = [(each.topic, old.topics[each.topic], each.data)]
            for one in derived.of(each.topic[1:], each.data):
                rows.append((f"/{one.topic.lstrip('/')}", one.type_name, one.data))
            for name, type_name, data in rows:
                if name not in new.topics:
                    new.add_topic(name, type_name)
                new.write(name, data, each.log_time_ns, each.publish_time_ns)
    return folder / "bag"


@pytest.fixture(scope="module")
def recording(bag: Path) -> Path:
    """Convert the bag."""
    file = bag.parent / "drive.rrd"
    assert report.main([str(bag), "--rerun", str(file)]) == 0
    return file


def free_port() -> int:
    """Return a port that no process uses."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextmanager
def served(file: Path) -> Iterator[str]:
    """Serve a recording and the web viewer; yield the address of the page."""
    web, data = free_port(), free_port()
    command = [sys.executable, "-m", "rerun", str(file), "--serve-web", "--bind", "127.0.0.1"]
    command += ["--web-viewer-port", str(web), "--port", str(data)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # the module starts the program of the viewer
    )
    try:
        limit = time.monotonic() + TIMEOUT
        while time.monotonic() < limit:
            with socket.socket() as one:
                if one.connect_ex(("127.0.0.1", web)) == 0:
                    break
            time.sleep(0.1)
        source = quote(f"rerun+http://127.0.0.1:{data}/proxy", safe="")
        yield f"http://127.0.0.1:{web}/?url={source}&hide_welcome_screen&renderer=webgl"
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(TIMEOUT)


def places(picture: Picture, colour: Any) -> Picture:
    """Return row and column (n, 2) of the pixels of a colour."""
    return np.argwhere((abs(picture - np.array(colour)) <= TOLERANCE).all(axis=2))


def photograph(page: Any) -> Picture:
    """Return what a page shows (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), dtype=np.int64)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_path_driven_line_and_car_are_visible_in_the_web_viewer(recording: Path) -> None:
    car = [round(255 * part) for part in CAR_COLOUR[:3]]
    with served(recording) as address, open_browser(*SOFTWARE_GL) as browser:
        page = browser.new_page(viewport=SIZE)
        page.goto(address)
        limit = time.monotonic() + TIMEOUT
        while time.monotonic() < limit:
            picture = photograph(page)
            road, close, charts = picture[60:320, :690], picture[360:760, :690], picture[:, 720:]
            path, driven, body = (
                places(road, REFERENCE_RGB),
                places(road, DRIVEN_RGB),
                places(close, car),
            )
            lines = places(charts, DRIVEN_RGB)
            if min(map(len, (path, driven, body, lines))) > MOST_NOISE:
                break
            page.wait_for_timeout(500)
    assert min(map(len, (path, driven, body, lines))) > MOST_NOISE
    # Path and driven line cross the view of the road, one on the other.
    for each in (path, driven):
        assert np.ptp(each[:, 1]) > 250 or np.ptp(each[:, 0]) > 100
    assert abs(np.median(path, axis=0) - np.median(driven, axis=0)).max() < 150
    # The car is in the middle of the view that follows it, and on the path.
    centre = np.median(body, axis=0)
    assert abs(centre - (200, 345)).max() < 90
    near = places(close, REFERENCE_RGB)
    assert len(near) > MOST_NOISE
    assert abs(near[:, 1] - centre[1]).min() < 40


def test_without_the_package_one_line_says_what_to_install(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(rerun_file, "import_module", missing)
    arguments = [str(bag), "--output", str(tmp_path), "--rerun", str(tmp_path / "drive.rrd")]
    assert report.main(arguments) == 2
    assert "--rerun needs the package rerun-sdk: pip install rerun-sdk" in capsys.readouterr().out


def test_several_bags_are_refused(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report.main([str(bag), str(bag), "--rerun", "drive.rrd"]) == 2
    assert "--rerun takes one bag, not 2" in capsys.readouterr().out
