"""From a case's rig file to its `RigInfo` and its driver."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.further_channel_schema import FurtherChannelSpec
from rths_cli.case.resolve import VARIED
from rths_cli.case.rig_schema import (
    DEFAULT_LOST_SAMPLES,
    ChannelSpec,
    NiRigSpec,
    PluginRigSpec,
    RealRigSpec,
    SensorsSpec,
    TargetRigSpec,
    UdpPlainRigSpec,
    UdpRigSpec,
    VirtualActuatorSpec,
    VirtualRigSpec,
    is_loopback,
)
from rths_cli.errors import InputError, RigError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo, Uncertainty
from rths_cli.rigs.interface import specimen_known
from rths_cli.structure import assemble, masses_of
from rths_cli.structure.storey_laws import stacked

if TYPE_CHECKING:
    from rths_cli.case.calibration_schema import CalibratedMass, CalibrationSpec
    from rths_cli.case.case_schema import Case
    from rths_cli.case.rig_schema import LimitsSpec, PlainLinkSpec, RealSensorsSpec, RigSpec
    from rths_cli.numerics.lti import Array
    from rths_cli.rigs.interface import Rig
    from rths_cli.rigs.ni.ni_rig import NiRig
    from rths_cli.rigs.udp.plain_rig import Cable, PlainRig
    from rths_cli.rigs.udp.udp_rig import UdpRig
    from rths_cli.rigs.virtual.laboratory import Laboratory
    from rths_cli.rigs.virtual.virtual_rig import VirtualRig
    from rths_cli.structure import Building, Specimen
    from rths_cli.structure.storey_laws import Laws

SAME = 1e-6  # relative difference within which a stated number is the same


def rig_info(case: Case) -> RigInfo:
    """Return what is known of the case's rig with its structure on it: as declared, and as calibrated where its file
    names a calibration."""
    info = declared_info(case)
    if case.table.calibration is None:
        return info
    return _as_calibrated(info, case.table.calibration, weighed(case), case.structure.experimental.masses_kg)


def weighed(case: Case) -> tuple[CalibratedMass, ...]:
    """Return the masses of the floors on the table that a case's calibration holds.

    () where another structure was weighed, which has another name and other masses.
    """
    calibration = case.table.calibration
    if calibration is None:
        return ()
    if calibration.specimen in ("", case.structure.name.removesuffix(VARIED)):
        return calibration.masses
    stated = dict(zip(channel_names(case)[1:], case.structure.experimental.masses_kg, strict=True))
    alike = all(one.floor in stated and _agree(stated[one.floor], one) for one in calibration.masses)
    return calibration.masses if alike else ()


def _agree(stated_kg: float, one: CalibratedMass) -> bool:
    """Return whether a structure states a mass as it was weighed."""
    return abs(stated_kg / one.mass_kg - 1.0) <= max(one.mass_uncertainty, SAME)


def _as_calibrated(
    info: RigInfo, calibration: CalibrationSpec, balance: Sequence[CalibratedMass], masses_kg: Sequence[float]
) -> RigInfo:
    """Return a rig with the sensitivities and uncertainties of a calibration in the place of the declared ones.

    What the structure states of a mass, `masses_kg` (n,), is off by its difference from the weighed one as well.
    """
    found = {one.name: one for one in calibration.channels}
    stated = {channel.name: mass for channel, mass in zip(info.channels[1:], masses_kg, strict=True)}
    uncertain = {
        one.floor: math.hypot(one.mass_uncertainty, math.log(stated[one.floor] / one.mass_kg))
        for one in balance
        if one.floor in stated
    }

    def of(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        return tuple(
            replace(
                channel,
                sensitivity_v_per_unit=found[channel.name].sensitivity_v_per_unit,
                uncertainty=found[channel.name].sensitivity_uncertainty,
            )
            if channel.name in found
            else channel
            for channel in channels
        )

    masses = tuple(uncertain.get(channel.name, info.uncertainty.mass) for channel in info.channels[1:])
    uncertainty = replace(info.uncertainty, masses=masses) if uncertain else info.uncertainty
    return replace(info, channels=of(info.channels), further=of(info.further), uncertainty=uncertainty)


def calibration_faults(case: Case) -> Iterator[str]:
    """Yield a sentence for each thing in which a case's calibration belongs to another rig, sensor or specimen."""
    calibration, key = case.table.calibration, "table.calibration"
    if calibration is None:
        return
    again = "calibrate again (rths calibrate), or remove the key"
    if calibration.rig != case.table.name.removesuffix(VARIED):
        yield f"{key}: belongs to rig {calibration.rig}, this one is {case.table.name}; {again}"
        return
    info = declared_info(case)
    declared = {channel.name: channel.sensitivity_v_per_unit for channel in info.all_channels}
    if foreign := [one.name for one in calibration.channels if one.name not in declared]:
        yield f"{key}: holds channel {', '.join(foreign)}, the rig has {', '.join(declared)}; {again}"
    stale = [
        f"{one.name} {one.declared_v_per_unit:.6g}, now {declared[one.name]:.6g}"
        for one in calibration.channels
        if one.name in declared and abs(declared[one.name] / one.declared_v_per_unit - 1.0) > SAME
    ]
    if stale:
        yield f"{key}: was made when the rig file declared other sensitivities ({'; '.join(stale)} V per unit); {again}"
    masses = dict(zip(channel_names(case)[1:], case.structure.experimental.masses_kg, strict=True))
    for one in weighed(case):
        stated = masses.get(one.floor)
        if stated is None:
            yield f"{key}: holds the mass of {one.floor}, on the table stand {', '.join(masses)}; {again}"
        elif not _agree(stated, one):
            yield (
                f"{key}: {one.floor} weighs {one.mass_kg:.6g} kg +- {100 * one.mass_uncertainty:.2g} %, "
                f"the structure states {stated:.6g}; correct masses_kg of the structure, or weigh again"
            )


def declared_info(case: Case) -> RigInfo:
    """Return what the case's rig file declares, without regard to a calibration."""
    table = case.table
    names = channel_names(case)
    real = table if isinstance(table, RealRigSpec) else None
    return RigInfo(
        name=table.name,
        kind=table.kind,
        dt_s=1.0 / case.sample_rate_hz,
        channels=_own_channels(table, names),
        converters=Converters(table.converters.bits, table.converters.range_v),
        latency_samples=table.converters.latency_samples,
        limits=_limits(table.limits),
        gain_m_per_v=table.nominal.gain_m_per_v,
        moving_mass_kg=table.nominal.moving_mass_kg + case.structure.interface_experimental_mass_kg,
        specimen_mass_kg=float(sum(case.structure.experimental.masses_kg)),
        unattended=real is not None and real.unattended and case.rig_file is not None,
        watchdog_s=_watchdog_s(real),
        overrun=real.overrun if real else "skip",
        driver_verified=_driver_verified(real),
        further=_further(table),
        uncertainty=Uncertainty(**table.uncertainty.model_dump()),
        interface="displacement" if isinstance(table, VirtualActuatorSpec) else "acceleration",
    )


def channel_names(case: Case) -> tuple[str, ...]:
    """Return the roles of the channels: the table, then the experimental floors upwards, numbered from the ground."""
    if case.structure.experimental.attached:
        return "displacement", "force"
    numerical = len(masses_of(case.structure))
    return ("table", *(f"floor_{numerical + 1 + i}" for i in range(len(case.structure.experimental.masses_kg))))


def _own_channels(table: RigSpec, names: tuple[str, ...]) -> tuple[Channel, ...]:
    """Return the channels that the control uses: accelerometers, or an actuator's displacement and force."""
    if isinstance(table, VirtualActuatorSpec):
        one = table.sensors
        numbers = (
            ("displacement", one.displacement_v_per_m, one.displacement_range_m),
            ("force", one.force_v_per_n, one.force_range_n),
        )
        return tuple(
            Channel(name, size, span, 0.0, 0.0, kind=name, position="actuator", uncertainty=one.uncertainty)
            for name, size, span in numbers
        )
    if isinstance(table, VirtualRigSpec):
        return _virtual_channels(table, names)
    assert isinstance(table, RealRigSpec)
    return _channels(table, names)


def _virtual_channels(table: VirtualRigSpec, names: tuple[str, ...]) -> tuple[Channel, ...]:
    sensors: SensorsSpec = table.sensors
    sensitivity = sensors.sensitivity_mv_per_g / 1000.0 / STANDARD_GRAVITY_M_S2
    span = sensors.range_g * STANDARD_GRAVITY_M_S2
    return tuple(
        Channel(
            name, sensitivity, span, sensors.high_pass_hz, sensors.low_pass_hz, position=name,
            uncertainty=sensors.uncertainty,
        )
        for name in names
    )  # fmt: skip


def _channels(table: RealRigSpec, names: tuple[str, ...]) -> tuple[Channel, ...]:
    """Return the channels of a real rig: listed one by one, or all alike."""
    listed: tuple[RealSensorsSpec, ...] = table.accelerometers
    alike = (table.sensors,) * len(names) if table.sensors is not None else ()
    return tuple(_channel(name, one) for name, one in zip(names, listed or alike, strict=True))


def _channel(name: str, spec: RealSensorsSpec) -> Channel:
    own = spec if isinstance(spec, ChannelSpec) else None
    return Channel(
        name,
        spec.volts_per_m_s2,
        spec.range_g * STANDARD_GRAVITY_M_S2,
        spec.high_pass_hz,
        spec.low_pass_hz,
        sign=float(spec.sign),
        warning=_or_none(spec.warning_m_s2),
        abort=_or_none(spec.abort_m_s2),
        label=own.name if own else "",
        terminal=own.terminal or "" if own else "",
        position=name,
        uncertainty=spec.uncertainty,
    )


def _further(table: RigSpec) -> tuple[Channel, ...]:
    """Return the channels beside the accelerometers of table and floors, each named by kind and position."""
    found: list[Channel] = []
    listed = table.channels if isinstance(table, VirtualRigSpec | RealRigSpec) else None
    for spec in listed or ():
        if isinstance(spec, FurtherChannelSpec):
            same = sum(one.kind == spec.kind and one.position == spec.position for one in found)
            found.append(_further_channel(spec, f"{spec.position}_{spec.kind}{f'_{same + 1}' if same else ''}"))
    return tuple(found)


def _further_channel(spec: FurtherChannelSpec, name: str) -> Channel:
    size = spec.unit_si
    return Channel(
        name,
        spec.sensitivity_v_per_unit / size,
        spec.range * size,
        spec.high_pass_hz,
        spec.low_pass_hz,
        sign=float(spec.sign),
        warning=_or_none(spec.warning) * size,
        abort=_or_none(spec.abort) * size,
        label=spec.name,
        terminal=spec.terminal or "",
        kind=spec.kind,
        position=spec.position,
        uses=spec.uses,
        uncertainty=spec.sensitivity_uncertainty,
        noise_rms=(spec.noise_rms or 0.0) * size,
        plate_mass_kg=spec.plate_mass_kg or 0.0,
        height_m=spec.height_m or 0.0,
    )


def _limits(limits: LimitsSpec) -> Limits:
    return Limits(
        limits.stroke_m,
        limits.velocity_m_s,
        limits.acceleration_m_s2,
        limits.force_n,
        command_rate_v_s=_or_none(limits.command_rate_v_s),
        tracking_error_m_s2=_or_none(limits.tracking_error_m_s2),
        energy_ratio=_or_none(limits.energy_ratio),
        lost_samples=DEFAULT_LOST_SAMPLES if limits.lost_samples is None else limits.lost_samples,
        tracking_error_m=_or_none(getattr(limits, "tracking_error_m", None)),
    )


def _or_none(limit: float | None) -> float:
    """Return a limit, infinite where none is stated."""
    return math.inf if limit is None else limit


def _watchdog_s(real: RealRigSpec | None) -> float:
    """Return after which silence the rig rests its table by itself, 0 for a card without watchdog."""
    if isinstance(real, UdpRigSpec | UdpPlainRigSpec | TargetRigSpec | PluginRigSpec):
        return real.watchdog_s
    return RigInfo.watchdog_s if real is None else 0.0


def _driver_verified(real: RealRigSpec | None) -> str:
    """Return what the address of a target lets expect behind its driver; other drivers know once they are open."""
    if isinstance(real, UdpPlainRigSpec | TargetRigSpec):
        return "loopback" if is_loopback(real.link.host) else "hardware"
    if not isinstance(real, UdpRigSpec):
        return ""
    return "loopback" if real.udp.is_loopback else "hardware"


def driver(
    case: Case, info: RigInfo, building: Building, seed: Sequence[int], changed: bool,
    session: Sequence[int] | None = None,
) -> Rig:  # fmt: skip
    """Return the case's rig, made but not opened: nothing is connected, nothing moves.

    Where noise is drawn, `seed` names the run's, `session` the runs between which nothing drifts (None: this one
    alone), and `changed` tells whether the rig is what its file says it becomes after the identification. Raises
    InputError or RigError when a plug-in cannot make its rig.
    """
    table = case.table
    if isinstance(table, VirtualRigSpec):
        return virtual_driver(case, info, building, seed, changed, session)
    if isinstance(table, VirtualActuatorSpec):
        from rths_cli.rigs.virtual.actuator_rig import actuator_rig

        return actuator_rig(table, info, building.specimen, tuple(seed), case.seed)
    if isinstance(table, UdpRigSpec):
        return _udp(info, table)
    if isinstance(table, UdpPlainRigSpec):
        return _udp_plain(info, table)
    if isinstance(table, TargetRigSpec):
        from rths_cli.rigs.udp.stepping_rig import SteppingRig

        return SteppingRig(info, _cable(table.link, of_target=True), table.watchdog_s)
    if isinstance(table, NiRigSpec):
        return _ni(info, table)
    if isinstance(table, PluginRigSpec):
        from rths_cli.rigs.plugin_rigs import open_plugin

        return open_plugin(info, table.options)
    raise RigError(f"rig {info.name}: there is no driver for rigs of kind {info.kind}")


def virtual_driver(
    case: Case, info: RigInfo, building: Building, seed: Sequence[int], changed: bool,
    session: Sequence[int] | None = None,
) -> VirtualRig:  # fmt: skip
    """Return the virtual rig of a case; raises InputError where its rig is another."""
    from rths_cli.rigs.virtual.virtual_rig import virtual_rig

    mass, info = building.interface_experimental_mass_kg, _as_built(case, info)
    runs = None if session is None else tuple(session)
    return virtual_rig(simulated(case), info, building.specimen, mass, tuple(seed), changed, case.seed, runs)


def _as_built(case: Case, info: RigInfo) -> RigInfo:
    """Return a virtual rig's description with declared sensors: its hidden ones are off by what nobody can declare."""
    if case.table.calibration is None:
        return info
    declared = declared_info(case)
    return replace(info, channels=declared.channels, further=declared.further, uncertainty=declared.uncertainty)


def true_building(case: Case, declared: Building) -> Building | None:
    """Return the declared numerical storeys below the specimen as it is during the test; None where nobody knows it.

    The declared building itself where the specimen is as declared. Raises InputError for hidden laws that do not fit.
    """
    if not isinstance(case.table, VirtualRigSpec):
        return None
    from rths_cli.rigs.virtual.virtual_rig import true_specimen

    stated = declared.specimen
    specimen, laws = true_specimen(case.table, stated, case.seed)
    pairs = ((specimen.masses_kg, stated.masses_kg), (specimen.K, stated.K), (specimen.C, stated.C))
    if laws.code.size == 0 and all(np.array_equal(*pair) for pair in pairs):
        return declared
    return _with_specimen(declared, specimen, laws)


def told_building(rig: Rig, declared: Building) -> Building | None:
    """Return the declared numerical storeys below the specimen that an open rig of a package says it has; None where
    it does not say. Raises RigError for one that does not fit the rig."""
    teller = specimen_known(rig)
    if teller is None:
        return None
    from rths_cli.rigs.virtual.plant_kernel import specimen_with_laws

    try:
        told = specimen_with_laws(*teller.specimen(), STANDARD_GRAVITY_M_S2)
    except InputError as error:
        raise RigError(f"rig {rig.info.name}: laws of its specimen: {'; '.join(error.faults)}") from error
    return _with_specimen(declared, *told)


def _with_specimen(declared: Building, specimen: Specimen, laws: Laws) -> Building:
    """Return the declared numerical storeys below another specimen, in which is what its laws add at rest."""
    M, C, K = assemble(declared.numerical, specimen, declared.interface_experimental_mass_kg)
    together = stacked(declared.laws, laws, len(declared.numerical.masses_kg))
    return replace(declared, specimen=specimen, M=M, C=C, K=K, laws=together)


def laboratory_number(case: Case) -> int | None:
    """Return the number of the virtual laboratory that a case is in; None where nothing differs from its files."""
    if not isinstance(case.table, VirtualRigSpec | VirtualActuatorSpec):
        return None
    from rths_cli.rigs.virtual.laboratory import number_of

    return number_of(case.table.imperfections, case.seed)


def laboratory_follows_seed(case: Case) -> bool:
    """Return whether another seed of a case is another laboratory."""
    number = laboratory_number(case)
    return number is not None and number != laboratory_number(case.model_copy(update={"seed": case.seed + 1}))


def true_values(case: Case, info: RigInfo) -> dict[str, Array]:
    """Return the values of a laboratory with imperfections by dotted key, none of one that is as declared."""
    laboratory = _laboratory(case, info)
    return {} if laboratory is None else dict(laboratory.values)


def skew_faults(case: Case, info: RigInfo) -> list[str]:
    """Return a sentence where the command of a virtual rig with latency would act too far from its clock, by the key
    that states it."""
    if not isinstance(case.table, VirtualRigSpec):
        return []
    from rths_cli.rigs.virtual.imperfect.skew_check import skew_faults as of_spec

    own_s = float(np.ravel(true_values(case, info).get("converters.command_skew_s", 0.0))[0])
    return of_spec(case.table, info, own_s)


def true_values_of_run(
    case: Case, info: RigInfo, seed: Sequence[int], session: Sequence[int] | None = None
) -> dict[str, Array]:
    """Return what such a laboratory draws anew for each run or session, by dotted key; `seed` names the run's noise,
    `session` the runs between which nothing drifts (None: this one alone)."""
    from rths_cli.rigs.virtual.laboratory import of_run

    laboratory = _laboratory(case, info)
    runs = None if session is None else tuple(session)
    return {} if laboratory is None else of_run(laboratory, tuple(seed), len(info.all_channels), runs)


def _laboratory(case: Case, info: RigInfo) -> Laboratory | None:
    if laboratory_number(case) is None or info.interface != "acceleration":
        return None
    from rths_cli.rigs.virtual.virtual_rig import true_laboratory

    floors = len(case.structure.experimental.masses_kg)
    return true_laboratory(
        simulated(case), case.seed, floors, [one.uncertainty for one in _as_built(case, info).further]
    )


def simulated(case: Case) -> VirtualRigSpec:
    """Return the rig of a case that is simulated; raises InputError for one that is not."""
    if not isinstance(case.table, VirtualRigSpec):
        raise InputError(f"{case.table.name}: its kind is {case.table.kind}; only a virtual rig can be simulated")
    return case.table


def check_link(case: Case) -> None:
    """Raise InputError if what the link to a rig needs is missing here, as a key file; nothing is opened."""
    if isinstance(case.table, UdpRigSpec):
        from rths_cli.rigs.udp.session import read_secret

        read_secret(case.table.udp.key_file)


def _udp(rig: RigInfo, table: UdpRigSpec) -> UdpRig:
    """Return the rig behind UDP that a rig file describes."""
    from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget

    there = table.udp
    target = UdpTarget(
        there.host, there.port, there.key_file, there.timeout_s, table.watchdog_s, rig.limits.lost_samples
    )  # fmt: skip
    return UdpRig(rig, target)


def _udp_plain(rig: RigInfo, table: UdpPlainRigSpec) -> PlainRig:
    """Return the rig at the end of a private cable that a rig file describes."""
    from rths_cli.rigs.udp.plain_rig import PlainRig

    return PlainRig(rig, _cable(table.link, table.clock == "target"), table.watchdog_s)


def _cable(link: PlainLinkSpec, of_target: bool) -> Cable:
    from rths_cli.rigs.udp.plain_rig import Cable

    return Cable(link.interface, link.own_port, link.host, link.port, of_target)


def _ni(rig: RigInfo, table: NiRigSpec) -> NiRig:
    """Return the rig on an NI card that a rig file describes."""
    from rths_cli.rigs.ni.daqmx import Wiring
    from rths_cli.rigs.ni.ni_rig import NiRig

    card = table.ni
    terminals = tuple(channel.terminal for channel in rig.all_channels)
    wiring = Wiring(
        card.device, card.command_channel, terminals, card.enable_line or "", card.wiring,
        rig.converters.range_v, 1.0 / rig.dt_s, card.timeout_s,
    )  # fmt: skip
    return NiRig(rig, wiring)
