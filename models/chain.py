"""A cantilever of N bricks end to end that sags under gravity and a side wind."""

import rbsd_sym as rs

T_END = 1.0
N = 16
COLUMNS = (f"brick_{N}.displacement", "joint_1.torque_local")


def scene(n: int = N) -> rs.Scene:
    """Return the chain: bricks of 1 m and 20 kg on stiff joints, which are softest in torsion.

    Arguments:
        n: number of bricks.
    """
    bricks, joints = [], []
    for i in range(1, n + 1):
        bricks.append(
            rs.RigidBody(
                f"brick_{i}",
                20,
                (0.08333333333333336, 1.7333333333333334, 1.6833333333333333),
                position=(i - 0.5, 0, 0),
                size=(1, 0.1, 0.2),
            )
        )
        joints.append(
            rs.RigidBodySpringDamper(
                f"joint_{i}",
                rs.Marker(f"brick_{i - 1}", (0.5, 0, 0)) if i > 1 else rs.Marker(rs.GROUND),
                rs.Marker(f"brick_{i}", (-0.5, 0, 0)),
                stiffness=(1e6, 1e6, 1e6, 1e4, 1e5, 1e5),
                damping=(2e3, 2e3, 2e3, 20, 200, 200),
            )
        )
    # The wind is a second component of gravity: a force in proportion to the mass.
    return rs.Scene("chain", bricks, joints, gravity=(0, 2.0, -9.6))
