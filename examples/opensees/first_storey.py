"""The lower storey of the paper's building: a column that is fixed at both ends, in N, mm, s and tonnes.

Node 2 is the interface floor. Its mass is that of the computed part, 6.93 kg.
"""

import openseespy.opensees as ops

HEIGHT_MM = 300.0
STIFFNESS_N_PER_MM = 7.353976
MASS_T = 6.93e-3


def build():
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    ops.node(1, 0.0, 0.0)
    ops.node(2, 0.0, HEIGHT_MM)
    ops.fix(1, 1, 1, 1)
    ops.fix(2, 0, 0, 1)  # the floor does not turn
    ops.mass(2, MASS_T, 0.0, 0.0)
    ops.geomTransf("Linear", 1)
    area, modulus = 100.0, 2.0e5
    inertia = STIFFNESS_N_PER_MM * HEIGHT_MM**3 / (12.0 * modulus)
    ops.element("elasticBeamColumn", 1, 1, 2, area, modulus, inertia, 1)
    ops.timeSeries("Linear", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(2, 0.0, -9.81 * 1e3 * MASS_T, 0.0)
