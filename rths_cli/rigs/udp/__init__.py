"""A rig behind UDP: packets, session and link of a target that runs on a microcontroller or as `rths serve`."""
