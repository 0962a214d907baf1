"""MuJoCo: a clamped chain of capsules between several spheres, which relaxes to rest at each drive position.

Links and hinges are those of `hinge_chain`; the first half link is clamped. The spheres, in whose plane the chain lies,
move instead of the base. A state at rest needs contacts that do not flicker; others are NaN.
"""

import mujoco
import numpy as np

from peers.hinge_chain import STILL, THICKNESS
from peers.scene import Circles

MOST = 3000  # time steps
CONTACT = 'solref="0.2 1" solimp="0.99999 0.99999 0.001"'


def model(scene: Circles, links: int) -> mujoco.MjModel:
    """Upright chain with its base at the origin; joints in order from base to tip."""
    h, chain = 1 / links, ""
    for number in reversed(range(links + 1)):
        length = h if 0 < number < links else h / 2
        inside = f'<geom type="capsule" size="{THICKNESS}" fromto="0 0 0 0 {length} 0" mass="1e-3"/>{chain}'
        joint = (
            f'<joint axis="0 0 1" stiffness="{links}" damping="{1.6 * links}" armature="{links}"/>' if number else ""
        )
        above = 0 if number == 0 else h / 2 if number == 1 else h
        chain = f'<body pos="0 {above} 0">{joint}{inside}</body>'
    spheres = "".join(
        f'<geom type="sphere" size="{radius - THICKNESS}" pos="{x} {y} 0" contype="2" conaffinity="1"/>'
        for x, y, radius in scene.circles
    )
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 0" timestep="0.1" integrator="implicitfast"/>
          <default><geom condim="1" {CONTACT} contype="1" conaffinity="2"/></default>
          <worldbody>
            <body mocap="true">{spheres}</body>
            {chain}
          </worldbody>
        </mujoco>""")


def scan(scene: Circles, control: np.ndarray, links: int) -> np.ndarray:
    """Support reactions fx, fy, mz at every drive position, (steps, 3)."""
    chain = model(scene, links)
    data = mujoco.MjData(chain)
    reactions, wrench = [], np.zeros(6)
    for u in control:
        data.mocap_pos[0, 0] = -u
        for _ in range(MOST):
            mujoco.mj_step(chain, data)
            if np.max(np.abs(data.qvel)) < STILL:
                break
        else:
            reactions.append((np.nan,) * 3)
            continue
        mujoco.mj_forward(chain, data)
        fx = fy = mz = 0.0
        for number, one in enumerate(data.contact):
            mujoco.mj_contactForce(chain, data, number, wrench)
            push = wrench[0] * one.frame[:2]  # along the normal from sphere to chain
            fx, fy = fx - push[0], fy - push[1]
            mz -= one.pos[0] * push[1] - one.pos[1] * push[0]
        reactions.append((fx, fy, mz))
    return np.array(reactions)
