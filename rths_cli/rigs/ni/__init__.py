"""A rig on an NI card in this machine: hardware-timed single point through the package `nidaqmx`."""
