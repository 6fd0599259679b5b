"""A three-storey, two-bay frame of soft aluminium strips that yield, in N, mm, s and tonnes.

Fibre sections, 27 equations. Each floor has its mass at its left node; node 31 is the interface, where the specimen
stands.
"""

import openseespy.opensees as ops

STOREYS, BAYS = 3, 2
HEIGHT_MM, SPAN_MM, WIDTH_MM = 300.0, 400.0, 20.0
COLUMN_MM, BEAM_MM = 5.0, 8.0  # thickness of the strips
MODULUS, YIELD, HARDENING = 7.0e4, 30.0, 0.02  # N/mm^2, N/mm^2, of the modulus
FLOOR_T = 6.93e-3
LAYERS, POINTS = 8, 3  # fibres over the thickness, integration points


def strip(tag, thickness_mm):
    ops.section("Fiber", tag)
    half, width = thickness_mm / 2.0, WIDTH_MM / 2.0
    ops.patch("rect", 1, LAYERS, 1, -half, -width, half, width)
    ops.beamIntegration("Lobatto", tag, tag, POINTS)


def build():
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    ops.uniaxialMaterial("Steel02", 1, YIELD, MODULUS, HARDENING, 20.0, 0.925, 0.15)
    strip(1, COLUMN_MM)
    strip(2, BEAM_MM)
    ops.geomTransf("PDelta", 1)
    ops.geomTransf("Linear", 2)
    for level in range(STOREYS + 1):
        for line in range(BAYS + 1):
            ops.node(10 * level + line + 1, line * SPAN_MM, level * HEIGHT_MM)
    for line in range(BAYS + 1):
        ops.fix(line + 1, 1, 1, 1)
    for level in range(STOREYS):
        ops.mass(10 * (level + 1) + 1, FLOOR_T, 0.0, 0.0)
        for line in range(BAYS + 1):
            below, node = 10 * level + line + 1, 10 * (level + 1) + line + 1
            ops.element("dispBeamColumn", node, below, node, 1, 1)
            if line < BAYS:
                ops.element("dispBeamColumn", 100 + node, node, node + 1, 2, 2)
    ops.timeSeries("Linear", 1)
    ops.pattern("Plain", 1, 1)
    for level in range(1, STOREYS + 1):
        for line in range(BAYS + 1):
            ops.load(10 * level + line + 1, 0.0, -9.81e3 * FLOOR_T / (BAYS + 1), 0.0)
