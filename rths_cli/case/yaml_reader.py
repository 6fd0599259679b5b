"""Read YAML into nodes that know their line and column, and faults in it.

YAML 1.2 numbers (`1e-3`), booleans only `true` and `false`, one document, no repeated keys, no NaN or
infinity, and limits on size, nesting and alias expansion. Faults are collected, not raised one by one.
"""

from __future__ import annotations

import math
import os
import re
import stat
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from rths_cli.case.shipped_files import is_shipped
from rths_cli.safe_text import MOST_DIGITS

OPTIONS = ("--rig ", "--structure ", "rths serve ")  # what names a value on the command line beside --set
Scalar = str | int | float | bool | Path | None
MAX_BYTES = 1_000_000
MAX_NODES = 20_000
MAX_DEPTH = 50
_SPACES = re.compile("[\\u00a0\\u1680\\u2000-\\u200b\\u202f\\u205f\\u3000\\ufeff]")  # of other kinds than YAML's
_STRUCTURAL = re.compile(f"(?:^|:|-) *({_SPACES.pattern})|({_SPACES.pattern}) *:")
_TAG = "tag:yaml.org,2002:"
_QUOTED = re.compile(r"""["\\]|^ *(?:- )*(?:\? |'':)""", re.MULTILINE)
_SCALARS = {
    "null": (re.compile(r"^(?:~|null|)$"), ["~", "n", ""]),
    "bool": (re.compile(r"^(?:true|false)$"), list("tf")),
    "int": (re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789")),
    "float": (
        re.compile(
            r"^[-+]?(?:(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
        ),
        list("-+.0123456789"),
    ),
}


@dataclass(frozen=True)
class Source:
    """A file, or the command line: `label` is how faults name it, relative paths in it start at `folder`."""

    label: str
    folder: Path
    path: Path | None = None


@dataclass(frozen=True)
class Mark:
    """A place in a source; line and column count from 1, line 0 stands for the source as a whole."""

    source: Source
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.source.label}:{self.line}:{self.column}" if self.line else self.source.label


@dataclass(frozen=True)
class Fault:
    """One fault: where it is, the dotted key it is about (may be empty), and a sentence; `meant`: the keys that an
    unknown one may have meant."""

    mark: Mark
    key: str
    message: str
    meant: tuple[str, ...] = ()

    def __str__(self) -> str:
        label = self.mark.source.label
        told = f"{label}.".startswith(f"--set {self.key}.") or (label.startswith(OPTIONS))
        named = f"{self.key}: " if self.key and not told else ""
        return f"{self.mark}: {named}{self.message}"


@dataclass(frozen=True)
class Node:
    """A value of a YAML document with its place; children of a mapping also know the place of their key."""

    value: Scalar | tuple[Node, ...] | dict[str, Node]
    mark: Mark
    key_mark: Mark | None = None

    @property
    def place(self) -> Mark:
        """Return where the key stands, or the value when there is no key."""
        return self.key_mark or self.mark

    @property
    def children(self) -> dict[str, Node]:
        """Return the keys of a mapping; a list or a scalar has none."""
        return self.value if isinstance(self.value, dict) else {}


def plain(node: Node) -> Any:
    """Return the value without places: dict, tuple or scalar."""
    if isinstance(node.value, dict):
        return {key: plain(child) for key, child in node.value.items()}
    if isinstance(node.value, tuple):
        return tuple(plain(child) for child in node.value)
    return node.value


def join(path: str, key: str | int) -> str:
    """Return the dotted name of a key below `path`; a list index stands in brackets, counted from 1."""
    if isinstance(key, int):
        return f"{path}[{key + 1}]"
    shown = key if re.fullmatch(r"[\w+\-./\[\]]{1,80}", key) else repr(key[:40])
    return f"{path}.{shown}" if path else shown


def display(path: Path) -> str:
    """Return a path as faults show it: relative to the current folder when it lies below it, the name of a shipped file
    elsewhere."""
    relative = os.path.relpath(path)
    if not relative.startswith(".."):
        return printable(relative)
    return printable(path.stem if is_shipped(path) else str(path.absolute()))


def printable(text: str) -> str:
    """Return a text as it is, or quoted with escapes when a terminal could not show it on one line."""
    return text if text.isprintable() else repr(text)


def read_file(path: Path) -> tuple[str, Node | None, list[Fault]]:
    """Return text, document and faults of a YAML file; the document is None when nothing can be used."""
    source = Source(display(path), path.absolute().parent, path.absolute())
    try:
        info = os.stat(path)
        if not stat.S_ISREG(info.st_mode):
            kind = "a folder" if stat.S_ISDIR(info.st_mode) else "not a regular file"
            return "", None, [Fault(Mark(source), "", f"is {kind}; name a YAML file")]
        if info.st_size > MAX_BYTES:
            return "", None, [Fault(Mark(source), "", f"must be <= {MAX_BYTES} bytes, got {info.st_size}")]
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return "", None, [Fault(Mark(source), "", f"cannot be read: {reason}; check the path")]
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - (data.rfind(b"\n", 0, error.start) + 1) + 1
        return "", None, [Fault(Mark(source, line, column), "", "is not UTF-8 text; save the file as UTF-8")]
    return text, *parse(text, source)


def parse(text: str, source: Source) -> tuple[Node | None, list[Fault]]:
    """Return the document of a YAML text and its faults; the document is None when nothing can be used."""
    node, faults = _parsed(text, source)
    return node, list(faults)


@lru_cache(maxsize=100)
def _parsed(text: str, source: Source) -> tuple[Node | None, Sequence[Fault]]:
    """Read a text once: cases of one command name the same structures and rigs."""
    try:
        raw = _Loader(text).get_single_node()
    except _TooMuch as error:
        return None, [Fault(Mark(source), "", str(error))]
    except (yaml.YAMLError, ValueError, OverflowError, IndexError) as error:
        return None, [_syntax_fault(error, text, source)]
    converter = _Converter(source, [])
    if raw is None:
        return Node(None, Mark(source, 1, 1)), []
    try:
        node = converter.node(raw, "", 0)
    except _TooMuch as error:
        return None, [Fault(Mark(source), "", str(error))]
    return node, converter.faults


def dump(data: object) -> str:
    """Return YAML text which `parse` reads back as the same data.

    PyYAML's dumper in C is several times as fast; it folds and escapes quoted text in another way than the one in
    Python, which therefore writes what holds such text.
    """
    text = _dumped(data, _FastDumper)
    return text if not _QUOTED.search(text) else dump_in_python(data)


def dump_in_python(data: object) -> str:
    """Return what `dump` must write, by the dumper in Python whatever the data: several times as slow."""
    return _dumped(data, _Dumper)


def _dumped(data: object, dumper: type[yaml.SafeDumper]) -> str:
    return str(yaml.dump(data, Dumper=dumper, sort_keys=False, allow_unicode=True, width=100))


class _TooMuch(Exception):
    """A document beyond the limits of nesting or size."""


def _resolvers() -> dict[str, list[tuple[str, re.Pattern[str]]]]:
    """Return PyYAML's table of implicit tags by first character, for scalars of YAML 1.2."""
    table: dict[str, list[tuple[str, re.Pattern[str]]]] = {}
    for name, (pattern, firsts) in _SCALARS.items():
        for first in firsts:
            table.setdefault(first, []).append((_TAG + name, pattern))
    return table


class _Loader(yaml.SafeLoader):
    """PyYAML's composer with YAML 1.2 scalars and with limits while it reads."""

    yaml_implicit_resolvers = _resolvers()

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.depth = 0
        self.count = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.depth += 1
        self.count += 1
        _check_size(self.depth, self.count)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Dumper(yaml.SafeDumper):
    """PyYAML's dumper that quotes what YAML 1.2 scalars would turn into something else."""

    yaml_implicit_resolvers = _resolvers()

    def ignore_aliases(self, data: Any) -> bool:
        return True


class _FastDumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """The same, in C where PyYAML was built with it."""

    yaml_implicit_resolvers = _resolvers()

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _check_size(depth: int, count: int) -> None:
    if depth > MAX_DEPTH:
        raise _TooMuch(f"must be nested at most {MAX_DEPTH} deep; this is not a case file")
    if count > MAX_NODES:
        raise _TooMuch(f"must hold at most {MAX_NODES} values, aliases expanded; this is not a case file")


def _syntax_fault(error: Exception, text: str, source: Source) -> Fault:
    """Return the place and the cause of a text that is not YAML."""
    line, column, problem = 1, 1, str(error).splitlines()[0] if str(error) else "unreadable"
    if isinstance(error, yaml.MarkedYAMLError):
        problem = error.problem or "unreadable"
        if error.problem_mark is not None:
            line, column = error.problem_mark.line + 1, error.problem_mark.column + 1
    elif isinstance(error, yaml.reader.ReaderError):
        problem = "a control character; save the file as plain text"
        line = text.count("\n", 0, error.position) + 1
        column = error.position - text.rfind("\n", 0, error.position)
    if "could not find expected ':'" in problem and line > 1:
        before = text.splitlines()[line - 2] if line - 2 < len(text.splitlines()) else ""
        if ":" not in before.partition("#")[0]:  # PyYAML notices it at the key after
            line, column, problem = line - 1, 1, f"a colon is missing in {before.strip()[:40]!r}; write KEY: VALUE"
        elif close := re.match(r"(\s*\w+):(?=[^\s:])", before):
            written = before.strip()[:40]
            line, column, problem = line - 1, close.end(), f"a space is missing behind the colon in {written!r}"
    if odd := _odd_space(text, line):
        line, column, problem = odd
    if "'\\t'" in problem:
        problem = "a tab; indent with spaces"
    if "single document" in str(error):
        problem = "a second document begins here; keep one"
    return Fault(Mark(source, line, column), "", f"not valid YAML: {problem}")


def _odd_space(text: str, last_line: int) -> tuple[int, int, str] | None:
    """Return place and name of a space that is none of YAML's where YAML needs one, in a line or the one before it."""
    for number, line in list(enumerate(text.splitlines()[:last_line], 1))[-2:]:
        plain = re.sub(r"\"[^\"]*\"|'[^']*'|#.*", lambda quoted: "x" * len(quoted[0]), line)
        if match := _STRUCTURAL.search(plain):
            place = match.start(1) if match[1] else match.start(2)
            return number, place + 1, f"{_named(plain[place])} stands here; type a usual space in its place"
    return None


def odd_space_in(key: str) -> tuple[int, str] | None:
    """Return the place in a key, from 0, of a space that is none of YAML's, and a sentence on it; None without one."""
    match = _SPACES.search(key)
    return None if match is None else (match.start(), f"{_named(match[0])} stands in this key; type it again without")


def _named(space: str) -> str:
    """Return the name of an unusual space: a no-break space, most often, as PDF and web pages hold it."""
    return f"a {unicodedata.name(space, 'space of another kind').lower()} (U+{ord(space):04X})"


@dataclass
class _Converter:
    """Turn PyYAML's nodes into ours and collect what is wrong with them."""

    source: Source
    faults: list[Fault]
    count: int = 0

    def node(self, raw: yaml.Node, path: str, depth: int) -> Node:
        self.count += 1
        _check_size(depth, self.count)
        mark = Mark(self.source, raw.start_mark.line + 1, raw.start_mark.column + 1)
        if isinstance(raw, yaml.MappingNode) and raw.tag == _TAG + "map":
            return Node(self.mapping(raw, path, depth), mark)
        if isinstance(raw, yaml.SequenceNode) and raw.tag == _TAG + "seq":
            items = (self.node(item, join(path, k), depth + 1) for k, item in enumerate(raw.value))
            return Node(tuple(items), mark)
        if isinstance(raw, yaml.ScalarNode):
            return Node(self.scalar(raw, mark, path), mark)
        self.faults.append(Fault(mark, path, f"tag {raw.tag!r} is not understood; remove it"))
        return Node(None, mark)

    def mapping(self, raw: yaml.MappingNode, path: str, depth: int) -> dict[str, Node]:
        children: dict[str, Node] = {}
        for key_mark, key, value in self.pairs(raw, path):
            child = replace(self.node(value, join(path, key), depth + 1), key_mark=key_mark)
            if key in children:
                first = children[key].place.line
                message = f"repeated key, first at line {first}; keep one"
                self.faults.append(Fault(key_mark, join(path, key), message))
            else:
                children[key] = child
        return children

    def pairs(self, raw: yaml.MappingNode, path: str) -> Iterator[tuple[Mark, str, yaml.Node]]:
        for key, value in raw.value:
            mark = Mark(self.source, key.start_mark.line + 1, key.start_mark.column + 1)
            text = self.scalar(key, mark, path) if isinstance(key, yaml.ScalarNode) else None
            if isinstance(text, str):
                yield mark, text, value
            else:
                self.faults.append(Fault(mark, path, "a key must be text; quote it"))

    def scalar(self, raw: yaml.ScalarNode, mark: Mark, path: str) -> Scalar:
        kind, text = raw.tag.removeprefix(_TAG), raw.value
        if kind in _SCALARS and not _SCALARS[kind][0].match(text):
            kind = "unknown"
        try:
            return _scalar(kind, text)
        except ValueError as error:
            self.faults.append(Fault(mark, path, str(error)))
            return None


def _scalar(kind: str, text: str) -> Scalar:
    """Return the value of a scalar of a known kind; ValueError carries the sentence."""
    if kind == "null":
        return None
    if kind == "bool":
        return text == "true"
    if kind == "int":
        if len(text) > MOST_DIGITS:
            raise ValueError(f"must be a whole number of at most {MOST_DIGITS} digits, got {len(text)} characters")
        return int(text)
    if kind == "float":
        value = float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        if not math.isfinite(value):
            raise ValueError(f"must be a finite number, got {text[:40]}")
        return value
    if kind != "str":
        raise ValueError(f"{text[:40]!r} carries a tag that is not understood; remove the tag")
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ValueError("is not valid Unicode text; remove the surrogate character")
    return text
