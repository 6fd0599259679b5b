"""What attributes and groups of model files mean."""

from __future__ import annotations

MODEL_ATTRIBUTES = {
    "format": "`rths-model`",
    "format_version": "1; files of a later version are refused",
    "created_utc": "when it was identified",
    "rths_version": "version of rths",
    "git_commit": "commit of rths, empty where it is installed as a package",
    "rig": "name of the rig",
    "rig_kind": "its kind",
    "rig_sha256": "SHA-256 of the rig file's values that a model depends on",
    "structure": "name of the structure whose specimen stood on the table",
    "specimen_sha256": "SHA-256 of what a model depends on of the specimen",
    "floor_masses_kg": "weighed floor masses",
    "interface_experimental_mass_kg": "part of the interface floor's mass on the table",
    "sample_rate_hz": "sample rate in Hz",
    "latency_samples": "declared latency in samples",
    "latency": "removed or kept, as in the case",
    "sensor_dynamics": "removed or kept, as in the case",
    "settings": "the identification's settings, as JSON",
    "seed": "seed of excitation and noise",
    "data_source": "where the records come from",
    "data_sha256": "SHA-256 of the records",
    "sha256": "SHA-256 of datasets and attributes; a file that holds others is refused",
}
MODEL_GROUPS = {
    "candidates": "model orders that were tried, error on the half of the data that was held out, the one chosen",
    "channels": "each channel: coherence, RMS, peak, hum, noise at rest",
    "fit_error": "\\|model / response - 1\\| over 0.7-11 Hz: RMS, largest, RMS over 2-10 Hz",
    "frf": "frequency response from command to a channel, its coherence and standard error",
    "friction": "dry friction as the change of the command that it is worth",
    "latency": "delay from command to table: declared, identified, its standard uncertainty",
    "level_causes": "what makes low and full level differ: causes in the table, storeys of the specimen",
    "levels": "response at low level over that at full level, by band",
    "residuals": "error of the model by band",
    "roots": "poles and zeros as frequency and damping ratio, with standard uncertainties",
    "specimen": "masses, stiffness, damping and modes of the specimen, from excitation and from free vibration",
    "table": "the table's model that a method uses: zeros, poles, gain, delay",
    "verdict": "1: accepted; band of the feedforward, delay, lag",
}
