"""The viewers' files: they can be read, and name only what the nodes publish and the viewers know.

The names of classes and panels are those in the sources of RViz2 (rviz_default_plugins and
rviz_common of Jazzy), Foxglove's layouts and PlotJuggler 3; these viewers do not run here.
test_two_cars.py compares the names with a recorded bag.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Float64
from visualization_msgs.msg import MarkerArray

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.recorder_node import CONTRACT
from ampc_msgs_config.types import REASONS, RECORD_QUANTITIES, RUNGS
from tests.layouts import split_path, values_at

FOLDER = Path(__file__).resolve().parents[2] / "ampc_ros" / "viewers"
JOINTS = {ros.STEERING_COMMAND: (ros.STEERING_JOINT,), ros.STEERING_STATE: (ros.STEERING_JOINT,)}
DERIVED = {ros.MARKERS: MarkerArray, **dict.fromkeys(ros.QUANTITIES, Float64)}
TYPES: dict[str, Any] = {**CONTRACT, **DERIVED}
TOPICS = {f"/{name.lstrip('/')}": kind for name, kind in TYPES.items()}

RVIZ_CLASSES = {
    *(f"rviz_common/{name}" for name in ("Displays", "Views", "Time")),
    *(f"rviz_default_plugins/{name}" for name in ("Grid", "TF", "Path", "Odometry", "MarkerArray")),
    *(f"rviz_default_plugins/{name}" for name in ("Interact", "MoveCamera", "Select", "Measure")),
    *(f"rviz_default_plugins/{name}" for name in ("FocusCamera", "TopDownOrtho")),
}
PANELS = {"3D", "Plot", "StateTransitions", "DiagnosticSummary"}


def rviz() -> Any:
    """Read the configuration of RViz2."""
    return yaml.safe_load((FOLDER / "ampc.rviz").read_text(encoding="utf-8"))


def foxglove() -> Any:
    """Read the layout of Foxglove."""
    return json.loads((FOLDER / "foxglove.json").read_text(encoding="utf-8"))


def plotjuggler() -> Any:
    """Read the layout of PlotJuggler."""
    return ElementTree.parse(FOLDER / "plotjuggler.xml").getroot()


def found(key: str, content: Any) -> Iterator[Any]:
    """Return the values of a key, anywhere in a document."""
    if isinstance(content, dict):
        if key in content:
            yield content[key]
        content = list(content.values())
    if isinstance(content, list):
        for each in content:
            yield from found(key, each)


def check_fields(kind: Any, words: list[str]) -> None:
    """Follow the names of fields into a message."""
    value = kind()
    for word in words:
        assert word in type(value).get_fields_and_field_types()
        value = getattr(value, word)


def test_rviz_knows_every_class_that_its_configuration_names() -> None:
    assert {name for name in found("Class", rviz()) if name} == RVIZ_CLASSES


def test_rviz_shows_the_topics_with_a_quality_of_service_that_their_publishers_offer() -> None:
    manager = rviz()["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == ros.MAP
    assert manager["Views"]["Current"]["Target Frame"] == ros.BASE_LINK
    shown = {each["Topic"]["Value"]: each for each in manager["Displays"] if "Topic" in each}
    names = {ros.REFERENCE_PATH, ros.PREDICTED_PATH, ros.ODOM, ros.MARKERS}
    assert shown.keys() == names
    for name, display in shown.items():
        shows = display["Class"].rpartition("/")[2]
        assert TOPICS[f"/{name}"].__name__ == shows
        latched = display["Topic"]["Durability Policy"] == "Transient Local"
        assert latched == (name == ros.REFERENCE_PATH)
        assert display["Enabled"]


def test_foxglove_shows_every_panel_once() -> None:
    content = foxglove()

    def leaves(layout: Any) -> list[str]:
        if isinstance(layout, str):
            return [layout]
        assert layout["direction"] in ("row", "column")
        assert 0 < layout["splitPercentage"] < 100
        return leaves(layout["first"]) + leaves(layout["second"])

    assert sorted(leaves(content["layout"])) == sorted(content["configById"])
    assert {name.partition("!")[0] for name in content["configById"]} == PANELS


def test_foxglove_s_scene_and_health_are_topics_of_ours() -> None:
    panels = foxglove()["configById"]
    scene = panels["3D!drive"]
    assert scene["followTf"] == ros.BASE_LINK
    assert set(scene["topics"]) == {"/markers", "/reference_path", "/predicted_path"} <= set(TOPICS)
    assert panels["DiagnosticSummary!health"]["topicToRender"] == ros.DIAGNOSTICS


@pytest.mark.parametrize("path", list(found("value", foxglove())))
def test_foxglove_plots_fields_that_the_messages_have(path: str) -> None:
    topic, fields = split_path(path)
    check_fields(TOPICS[topic], fields.partition("[")[0][1:].split("."))
    assert not re.search(r"\[-?\d", fields)  # names, no indices


def test_foxglove_finds_rung_and_reason_by_name() -> None:
    ladder = foxglove()["configById"]["StateTransitions!ladder"]
    paths = {each["label"]: split_path(each["value"]) for each in ladder["paths"]}
    for name in ("rung", "reason"):
        topic, fields = paths[name]
        values = [KeyValue(key="steering", value="0.1"), KeyValue(key=name, value="3")]
        own = DiagnosticStatus(name="/controller", values=values)
        other = DiagnosticStatus(name="/gate", values=[KeyValue(key=name, value="7")])
        assert topic == ros.DIAGNOSTICS
        assert values_at(fields, DiagnosticArray(status=[other, own])) == ["3"]
        assert name in RECORD_QUANTITIES  # health_numbers publishes all of them
    words = ", ".join(f"{number} {name}" for number, name in enumerate(RUNGS))
    assert words.replace("_", " ").replace("feed f", "feed-f") in ladder["foxglovePanelTitle"]
    assert REASONS[0] == "none"


def test_plotjuggler_s_layout_is_built_as_its_reader_takes_it() -> None:
    root = plotjuggler()
    tabs = root.find("tabbed_widget")
    assert root.tag == "root"
    assert tabs.attrib == {"name": "Main Window", "parent": "main_window"}
    for tab in tabs.iter("Tab"):
        containers = tab.findall("Container")
        assert len(containers) == int(tab.attrib["containers"]) == 1
        splitter = containers[0].find("DockSplitter")
        assert splitter.attrib["orientation"] in "|-"
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == len(splitter) == int(splitter.attrib["count"])
        assert sum(sizes) == pytest.approx(1.0, abs=1e-3)
        for area in splitter.findall("DockArea"):
            assert area.find("plot").attrib["style"] in ("Lines", "Steps")


@pytest.mark.parametrize("curve", [each.attrib["name"] for each in plotjuggler().iter("curve")])
def test_plotjuggler_plots_fields_that_the_messages_have(curve: str) -> None:
    topic = max((name for name in TOPICS if curve.startswith(f"{name}/")), key=len)
    words = curve.removeprefix(f"{topic}/").split("/")
    joints = {**JOINTS, ros.TICK: ros.TICK_QUANTITIES}.get(topic[1:])
    if joints:  # its reader of JointState: topic, joint, field
        joint, field = words
        assert joint in joints
        assert field == "position"
    else:
        check_fields(TOPICS[topic], words)
