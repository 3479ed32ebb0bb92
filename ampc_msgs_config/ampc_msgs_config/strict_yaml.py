"""Parse YAML 1.1 without its traps, with libyaml where it is installed.

Booleans are `true` and `false` only. Numbers are decimal, `1e-3` included. `yes`, `1:30`, `0017`,
`0x1F`, `1_0` and dates are text. A key that occurs twice in a mapping is an error.

The content is built in one pass from the events of a parser. With libyaml's parser that takes
about a second for 5 MB, with PyYAML's own ten. PyYAML's own is used where libyaml is missing,
and for short texts that libyaml rejects, because its messages quote the line, or may accept by
mistake.

Note:
    libyaml's loader is not used: it crashes on deep nesting.
"""

import math
import re
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any, NamedTuple

import yaml

from ampc_msgs_config.validation import dotted

MAX_NODES = 5_000_000
"""Greatest number of values in a text, where each alias counts as all that it stands for."""
MAX_DEPTH = 200
"""Greatest number of lists and mappings in one another."""
LONGEST_REPEATED = 100_000
"""Longest text that is parsed again for its message [characters]."""
LENIENT = re.compile("[\t?!\ufeff]")
"""Characters that libyaml accepts in more places, or reads differently."""
TAG = "tag:yaml.org,2002:"
"""Begin of the tags of YAML's own types."""
SCALARS = {
    "bool": re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z"),
    "int": re.compile(r"[-+]?(?:0|[1-9][0-9]*)\Z"),
    "float": re.compile(
        r"""[-+]?(?:(?:0|[1-9][0-9]*)\.[0-9]*(?:[eE][-+]?[0-9]+)?|\.[0-9]+(?:[eE][-+]?[0-9]+)?
        |(?:0|[1-9][0-9]*)[eE][-+]?[0-9]+|\.(?:inf|Inf|INF))\Z|\.(?:nan|NaN|NAN)\Z""",
        re.VERBOSE,
    ),
}
is_int, is_float = SCALARS["int"].match, SCALARS["float"].match
MERGE = object()
"""Key whose value, one or more mappings, is merged into the mapping around it."""
WORDS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    "<<": MERGE,
}
"""Values of the words that are not text."""


class Loader(yaml.SafeLoader):
    """PyYAML's own parser, and constructor of the scalars that have a tag."""

    yaml_constructors = {  # noqa: RUF012 (PyYAML's own registry, replaced as a whole)
        tag: yaml.SafeLoader.yaml_constructors[tag]
        for tag in (f"{TAG}str", f"{TAG}null", None)  # None: an unknown tag
    }


class Dumper(yaml.SafeDumper):
    """Safe YAML writer that quotes every text which `parse_yaml` would read as something else."""


def _construct(loader: Loader, node: yaml.ScalarNode) -> bool | int | float:
    """Return the value of a boolean or number, also where the text has an explicit tag."""
    text, kind = str(loader.construct_scalar(node)).lower(), node.tag.rpartition(":")[2]
    problem = f"{node.value!r} is not of the type {kind}"
    if SCALARS[kind].match(node.value):
        if kind != "float":
            return text == "true" if kind == "bool" else int(text)
        value = float(text.replace(".inf", "inf").replace(".nan", "nan"))
        if "inf" in text or not math.isinf(value):
            return value
        problem = f"{node.value} is beyond the range of floating-point numbers"
    raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)


for kind, pattern in SCALARS.items():
    Loader.add_constructor(TAG + kind, _construct)
    if kind != "bool":  # as PyYAML's own dumper quotes `yes`, too
        Dumper.add_implicit_resolver(TAG + kind, pattern, list("-+0123456789."))


def parse_yaml(text: str) -> Any:
    """Return the content of a YAML text.

    Raises:
        yaml.YAMLError: The text is no YAML, or has an unknown tag.
        ValueError: More than MAX_NODES values, a value that contains itself, a key that occurs
            twice in one mapping, or a whole number that is too long.
        RecursionError: More than MAX_DEPTH lists and mappings in one another.
    """
    is_long = len(text) > LONGEST_REPEATED
    if yaml.__with_libyaml__ and (is_long or not LENIENT.search(text)):
        try:
            return _Document(yaml.CSafeLoader(text).get_event).build()
        except (yaml.YAMLError, UnicodeError):
            if is_long:
                raise
    return _Document(Loader(text).get_event).build()


class _Anchored(NamedTuple):
    """What an alias stands for."""

    content: Any
    text: str | None
    """Text of a scalar; None: a list or mapping."""
    size: int
    """Number of values; 0: its end is not yet read."""
    mark: Any
    """Place of the anchor."""


class _Container:
    """List or mapping that is being read."""

    __slots__ = ("before", "content", "is_list", "key", "lines", "merged", "start", "text")

    def __init__(self, content: Any, start: Any, before: int) -> None:
        """Start empty.

        Args:
            content: Empty list or mapping.
            start: Event of its start.
            before: Number of values before it.
        """
        self.content, self.start, self.before = content, start, before
        self.is_list = type(content) is list
        self.key: Any = None
        self.text: str | None = None
        """Text of the key whose value comes next; None: a key comes next."""
        self.lines: dict[str, int] = {}
        """Lines of the keys, by text."""
        self.merged: Sequence[dict[Any, Any]] = ()
        """Values of the merge key; the first one prevails."""

    def takes_key(self) -> bool:
        """Return whether the next value is a key."""
        return not self.is_list and self.text is None

    def complete(self) -> Any:
        """Return the content, with what is merged before its own keys."""
        if not self.merged:
            return self.content
        merged = [each.items() for each in reversed(self.merged)]
        return dict(chain(*merged, self.content.items()))


class _Document:
    """Builds the content of a text from the events of a parser."""

    def __init__(self, next_event: Callable[[], Any]) -> None:
        """Start with the function that returns the next event, or None at the end."""
        self.next_event = next_event
        self.constructor = Loader("")
        self.content: Any = None
        self.start: Any = None
        """Place of the document, once it has started."""
        self.count = 0
        """Number of values so far, where each alias counts as all that it stands for."""
        self.containers: list[_Container] = []
        """Containers of the next value, the innermost one last."""
        self.anchors: dict[str, _Anchored] = {}

    def build(self) -> Any:
        """Return the content; errors as those of `parse_yaml`."""
        steps: dict[type, Callable[[Any], None]] = {
            yaml.DocumentStartEvent: self.on_document,
            yaml.ScalarEvent: self.on_scalar,
            yaml.AliasEvent: self.on_alias,
            yaml.SequenceStartEvent: self.on_start,
            yaml.MappingStartEvent: self.on_start,
            yaml.SequenceEndEvent: self.on_end,
            yaml.MappingEndEvent: self.on_end,
        }
        for event in iter(self.next_event, None):
            if step := steps.get(type(event)):
                step(event)
        return self.content

    def on_document(self, event: Any) -> None:
        """Reject a second document."""
        if self.start:
            problem, other = (
                "expected a single document in the stream",
                "but found another document",
            )
            raise yaml.composer.ComposerError(problem, self.start, other, event.start_mark)
        self.start = event.start_mark

    def on_scalar(self, event: Any) -> None:
        """Add a scalar."""
        text = event.value
        if event.implicit[0]:
            content = self.plain(text, event)
        else:
            content = text if event.tag in (None, "!") else self.tagged(event, event.tag)
        if event.anchor is not None and content is not MERGE:
            self.set_anchor(event, _Anchored(content, text, 1, event.start_mark))
        self.count += 1
        self.add(content, text, event)

    def plain(self, text: str, event: Any) -> Any:
        """Return the content of a scalar that has neither quotes nor a tag."""
        if text in WORDS:
            is_key = self.containers and self.containers[-1].takes_key()
            content = WORDS[text]
            return self.tagged(event, f"{TAG}merge") if content is MERGE and not is_key else content
        if text[0] not in "-+.0123456789":
            return text
        if is_float(text):
            if text[-1] not in "fFnN" and math.isfinite(content := float(text)):
                return content
            return self.tagged(event, f"{TAG}float")
        return int(text) if is_int(text) else text

    def tagged(self, event: Any, tag: str) -> Any:
        """Return the content of a scalar that has a tag."""
        node = yaml.ScalarNode(tag, event.value, event.start_mark, event.end_mark)
        return self.constructor.construct_object(node, deep=True)

    def on_alias(self, event: Any) -> None:
        """Add what an alias stands for."""
        anchored = self.anchors.get(event.anchor)
        if not anchored:
            problem = f"found undefined alias {event.anchor!r}"
            raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
        if not anchored.size:
            raise ValueError("an alias names what it is part of")
        self.count += anchored.size
        self.add(anchored.content, anchored.text, event)

    def on_start(self, event: Any) -> None:
        """Begin a list or mapping."""
        is_list = type(event) is yaml.SequenceStartEvent
        if event.tag and event.tag not in ("!", TAG + ("seq" if is_list else "map")):
            node = yaml.SequenceNode(event.tag, [], event.start_mark, event.end_mark)
            self.constructor.construct_undefined(node)
        if self.containers and self.containers[-1].takes_key():
            raise _constructor_error(self.containers[-1], "found unhashable key", event.start_mark)
        if len(self.containers) == MAX_DEPTH:
            raise RecursionError(f"maximum recursion depth exceeded: {MAX_DEPTH} values")
        if event.anchor is not None:
            self.set_anchor(event, _Anchored(None, None, 0, event.start_mark))
        self.containers.append(_Container([] if is_list else {}, event, self.count))
        self.count += 1

    def on_end(self, _: Any) -> None:
        """Complete a list or mapping."""
        ended = self.containers.pop()
        content, start = ended.complete(), ended.start
        if start.anchor is not None:
            size = self.count - ended.before
            self.anchors[start.anchor] = _Anchored(content, None, size, start.start_mark)
        self.add(content, None, start)

    def set_anchor(self, event: Any, anchored: _Anchored) -> None:
        """Set an anchor for the first time."""
        if before := self.anchors.get(event.anchor):
            problem = f"found duplicate anchor {event.anchor!r}; first occurrence"
            first, second = before.mark, event.start_mark
            raise yaml.composer.ComposerError(problem, first, "second occurrence", second)
        self.anchors[event.anchor] = anchored

    def add(self, content: Any, text: str | None, event: Any) -> None:
        """Add a value to the innermost container.

        Args:
            content: The value.
            text: Its text; None: a list or mapping.
            event: Event of its start.
        """
        if self.count > MAX_NODES:
            raise ValueError(f"more than {MAX_NODES} values, with aliases replaced")
        if not self.containers:
            self.content = content
            return
        around = self.containers[-1]
        if around.is_list:
            around.content.append(content)
        elif around.text is None:
            self.add_key(content, text, event.start_mark)
        else:
            if around.key is MERGE:
                around.merged = mappings(content, around, event.start_mark)
            else:
                around.content[around.key] = content
            around.text = None

    def add_key(self, content: Any, text: str | None, mark: Any) -> None:
        """Add a key to the innermost mapping."""
        around, line = self.containers[-1], mark.line + 1
        if text is None:
            raise _constructor_error(around, "found unhashable key", mark)
        if text in around.lines:
            raise self.repeated(text, line)
        around.key, around.text, around.lines[text] = content, text, line

    def repeated(self, text: str, line: int) -> ValueError:
        """Return the error that a key occurs twice."""
        name, around = "", self.containers[-1]
        for each in self.containers[:-1]:
            name = f"{name}[{len(each.content)}]" if each.is_list else dotted(name, str(each.text))
        value = self.next_event()
        shown = getattr(self.anchors.get(value.anchor), "text", None)
        if isinstance(value, yaml.ScalarEvent):
            shown = value.value
        return ValueError(
            f"{dotted(name, text)} = {'...' if shown is None else shown} in line {line} "
            f"repeats the key of line {around.lines[text]}"
        )


def mappings(content: Any, around: _Container, mark: Any) -> list[dict[Any, Any]]:
    """Return the mappings in the value of a merge key; the first one prevails.

    Raises:
        yaml.YAMLError: The value is something else.
    """
    parts = content if isinstance(content, list) else [content]
    for part in parts:
        if not isinstance(part, dict):
            wanted = "a mapping" if parts is content else "a mapping or list of mappings"
            kind = "sequence" if isinstance(part, list) else "scalar"
            problem = f"expected {wanted} for merging, but found {kind}"
            raise _constructor_error(around, problem, mark)
    return parts


def _constructor_error(mapping: _Container, problem: str, mark: Any) -> yaml.YAMLError:
    """Return the error that a part of a mapping is wrong."""
    where = "while constructing a mapping"
    return yaml.constructor.ConstructorError(where, mapping.start.start_mark, problem, mark)
