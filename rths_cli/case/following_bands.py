"""Fill in the bands of a case that follow its test band where it does not state them."""

from __future__ import annotations

from dataclasses import replace

from rths_cli.case.case_schema import TEST_BAND_RANGE, CaseKeys, IdentificationSpec, KalmanSpec
from rths_cli.case.yaml_tree import Fault, Node
from rths_cli.numerics.bands import with_test_band

FOLLOWING = (
    ("identification", "compared_hz", IdentificationSpec),
    ("identification", "low_hz", IdentificationSpec),
    ("identification", "high_hz", IdentificationSpec),
    ("kalman", "residual_hz", KalmanSpec),
)
"""Keys whose defaults belong to the default test band and keep their ratio to another one."""
EXCITED = 5.0  # default of identification.high_hz over the test band
EXCITED_SHARE = 0.2  # of the sample rate: highest frequency to which a table can be excited


def expand_test_band(children: dict[str, Node], faults: list[Fault], lost: set[str]) -> None:
    """Fill in what follows a stated test band; one that the sample rate cannot carry is a fault.

    A value that is no number, or out of range, is left to the model to refuse.
    """
    node = children.get("test_band_hz")
    band_hz, rate_hz = _number(node), _number(children.get("sample_rate_hz"))
    if node is None or band_hz is None or not TEST_BAND_RANGE.holds(band_hz):
        return
    rate_hz = CaseKeys.model_fields["sample_rate_hz"].default if rate_hz is None else rate_hz
    options = children.get("identification")
    stated = options is not None and isinstance(options.value, dict) and "high_hz" in options.value
    if not stated and EXCITED * band_hz > EXCITED_SHARE * rate_hz:
        why = (
            f"a table is identified up to {EXCITED:g} times the test band, at most {EXCITED_SHARE:g} of the sample rate"
        )
        most, advice = EXCITED_SHARE / EXCITED * rate_hz, "raise sample_rate_hz, or state identification.high_hz"
        faults.append(
            Fault(node.mark, "test_band_hz", f"must be <= {most:g}, because {why}, got {band_hz:g}; {advice}")
        )
        lost.add("test_band_hz")
    elif 2.0 * band_hz < rate_hz:
        for key, name, spec in FOLLOWING:
            _fill(children, key, name, spec.model_fields[name].default, node, band_hz)


def expand_filter_choice(children: dict[str, Node]) -> None:
    """Let a case that states weights of the floor filter have these; call it before the bands are filled in."""
    options = children.get("kalman")
    if options is not None and isinstance(options.value, dict):
        stated = {"q", "residual_hz"} & set(options.value)
        if stated and "choice" not in options.value:
            choice = Node("stated", options.mark, options.key_mark)
            children["kalman"] = replace(options, value={**options.value, "choice": choice})


def _fill(
    children: dict[str, Node], key: str, name: str, usual: float | tuple[float, ...], beside: Node, band_hz: float
) -> None:
    """Give the mapping at `key` the value of `name` that belongs to a test band, unless the case states one."""
    parent = children.get(key, Node({}, beside.mark, beside.key_mark))
    if not isinstance(parent.value, dict) or name in parent.value:
        return
    ends = usual if isinstance(usual, tuple) else (usual,)
    nodes = tuple(Node(with_test_band(hz, band_hz), beside.mark, beside.key_mark) for hz in ends)
    value = Node(nodes, beside.mark, beside.key_mark) if isinstance(usual, tuple) else nodes[0]
    children[key] = replace(parent, value={**parent.value, name: value})


def _number(node: Node | None) -> float | None:
    """Return the value of a node that holds a number, None for any other."""
    if node is None or isinstance(node.value, bool) or not isinstance(node.value, int | float):
        return None
    return float(node.value)
