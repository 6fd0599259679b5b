"""Play the table runs of a case on its real rig, with raw logs, live view and packet counts of the link."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from rths_cli.case.load import resolved_yaml
from rths_cli.experiment import real_rig_readiness
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.designed_step import case_sha256, checksum_number
from rths_cli.experiment.one_table_run import AFTER_S, BEFORE_S, RunPlan
from rths_cli.experiment.provenance import model_sha256
from rths_cli.experiment.real_rig_readiness import open_rig
from rths_cli.experiment.run_signals import as_stored
from rths_cli.files.raw_log import RawHeader, RawLogWriter, raw_log_path, still_in
from rths_cli.findings import Finding, stated
from rths_cli.loop.guard import LOG_FAILED, WATCHER_FAILED
from rths_cli.loop.live_view import View, Watching
from rths_cli.loop.realtime_run import STOP_KEY, Performance, Performed, order, perform_watched, prepare
from rths_cli.loop.run_log import LogStream, column_names, column_units, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL, assemble
from rths_cli.quantities.datasets import LINK_COUNTS
from rths_cli.rigs.from_case import told_building
from rths_cli.rigs.interface import linked, name_session, stepped
from rths_cli.rigs.stepped_test import Designed
from rths_cli.rigs.udp.link import echoed_latency

if TYPE_CHECKING:
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.model_choice import Memory
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.files.result_writer import ResultWriter
    from rths_cli.loop.simulated_time_run import Outcome
    from rths_cli.rigs.interface import Rig
    from rths_cli.structure import Building


def ask_the_rig(setup: Setup, memory: Memory, progress: Progress) -> None:
    """Rehearse the sample rate without the rig, unless its clock is counted, then measure the channels at rest.

    It is called before the table moves and before the result file is begun. Raises InputError if no controller can be
    designed, the machine does not hold the rate, or a channel is not at rest; RigError if the rig is not available.
    """
    design = design_blocks(setup, memory.at_rest(setup, progress).found)
    if setup.rig.can.steps_itself:
        progress("the target, its case and its model")
        rig = open_rig(setup, (), 0)
        with real_rig_readiness.opened(rig):
            _agree(rig, setup, design)
        return
    progress("rehearsal of the rate, no rig")
    rig = open_rig(setup, (), 0)
    real_rig_readiness.check_rate(setup, rig, design.blocks, NUMERICAL)
    progress("listening to the channels at rest")
    real_rig_readiness.listened(setup, rig)


class RealStage:
    """Play the runs of one case on its real rig.

    The samples are streamed to raw logs, which are kept until the result file holds them. `show` displays the label of
    a run and its live view; it returns True to stop the run.
    """

    def __init__(self, show: Callable[[str, View], bool]) -> None:
        self._show = show
        self.told: Building | None = None
        self._logs: list[RawLogWriter] = []

    def play(self, plan: RunPlan, writer: ResultWriter) -> Outcome:
        """Measure the channels' zeros anew, play one run and return its outcome.

        During the run the result file is closed, with the status interrupted. Raises InputError if a channel is not at
        rest or the raw log cannot be written, RigError if the rig is not available.
        """
        setup, kind = plan.setup, plan.kind
        rig, itself = open_rig(setup, (), 0), setup.rig.can.steps_itself
        zeros_v = None if itself else real_rig_readiness.listened(setup, rig).zeros_v
        writer.about({"driver_verified": rig.info.driver_verified})  # known only after the rig was opened
        blocks, still_s = plan.design.blocks, (BEFORE_S, AFTER_S)
        ready = prepare(setup.rig, blocks, kind.source, plan.drive, plan.limits, zeros_v, still_s=still_s)
        ready = replace(ready, foreseen=plan.foreseen)
        path = raw_log_path(writer.path, kind.name)
        log = RawLogWriter(path, _header(plan, ready, writer))
        self._logs.append(log)
        writer.park(f"{kind.label}: {still_in(path)}")
        watching = Watching(ready)
        name_session(rig, kind.name)

        def watch(performance: Performance) -> None:
            if self._show(kind.label, watching.look()):
                order(performance, STOP_KEY)

        with (
            LogStream(log, ready.log.columns, ready.log.done, ready.course.orders) as stream,
            real_rig_readiness.opened(rig),
        ):
            if itself:
                _agree(rig, setup, plan.design)
            self.told = told_building(rig, setup.building)
            performed = perform_watched(rig, ready, watch)
            counts, of_link = link_counts(rig), _about_link(rig)
        writer.resume()
        writer.about({"driver_verified": rig.info.driver_verified})
        told = _told(performed, ready, stream) | of_link
        writer.about({f"{kind.name}_{key}": value for key, value in told.items()})
        if counts:
            writer.group(f"{kind.name}/timing", counts)
        return _with_fault(performed, stream)

    def written(self) -> None:
        """Remove the raw logs, because the result file holds their samples."""
        for log in self._logs:
            log.remove()

    def close(self) -> None:
        """Close the raw logs; those that `written` did not remove are kept, except empty ones."""
        for log in self._logs:
            log.close()


def _agree(rig: Rig, setup: Setup, design: Design) -> None:
    """Raise RigError unless an open rig that steps itself holds the step of this case."""
    there = stepped(rig)
    assert there is not None
    columns = len(column_names(sizes_of(assemble(design.blocks, NUMERICAL))))
    case, model = checksum_number(case_sha256(setup.case)), checksum_number(model_sha256(design.model))
    there.agree(Designed(case, model, columns))


def link_counts(rig: Rig) -> dict[str, float]:
    """Return the packet counts of an open link, from arming to rest, by dataset name.

    Counts that the driver does not provide are left out; a rig without a link has none.
    """
    there = linked(rig)
    if there is None:
        return {}
    counts = there.counts
    return {f"link_{name}": float(counts[name]) for name in LINK_COUNTS if name in counts}


def _about_link(rig: Rig) -> dict[str, str | int | float]:
    """Return the attributes of a result that tell of an open link, without the run's prefix."""
    there = linked(rig)
    if there is None:
        return {}
    latency = echoed_latency(there.link)
    return {"link_peer": there.peer} | ({"link_latency_samples": latency} if math.isfinite(latency) else {})


def _with_fault(performed: Performed, stream: LogStream) -> Outcome:
    """Return the outcome of a run; if watcher or raw log ended it, the reason states their fault."""
    outcome = performed.outcome
    if outcome.reason == WATCHER_FAILED:
        return replace(outcome, stop=Finding("stop.live_view_failed", {"details": performed.watch_fault}))
    if outcome.reason == LOG_FAILED and stream.fault:
        return replace(outcome, stop=stated(stream.fault))
    return outcome


def _header(plan: RunPlan, ready: Performance, writer: ResultWriter) -> RawHeader:
    """Return the header of the raw log of a run."""
    setup, expected = plan.setup, as_stored(plan.expected) if plan.expected else None
    names = column_names(sizes_of(ready.step))
    return RawHeader(
        names, column_units(names), setup.rig.dt_s, ready.log.columns.shape[1], plan.design.blocks.lead_samples,
        plan.kind.name, writer.path.name, str(setup.case.path), setup.case.yaml_text, resolved_yaml(setup.case),
        writer.attributes, ready.course.ramp, ready.course.still, expected,
        tuple((one.name, one.units, one.ahead) for one in plan.design.blocks.logs),
    )  # fmt: skip


def _told(performed: Performed, ready: Performance, stream: LogStream) -> dict[str, str | int | float]:
    """Return the attributes of a result that describe the real-time loop of a run, without the run's prefix."""
    granted = performed.granted
    return {
        "zeros_v": " ".join(f"{zero:.6g}" for zero in ready.course.zeros_v),
        "overruns": performed.overruns,
        "fifo_priority": granted.fifo_priority,
        "cpu": granted.cpu,
        "memory_locked": int(granted.memory_locked),
        "not_granted": "\n".join(granted.refused),
        "log_fault": stream.fault,
        "log_behind_s": stream.worst_lag_s,
    }
