"""MuJoCo in space: a chain of rigid links and ball joints that relaxes to rest at each drive position.

This is the discretisation of MuJoCo's cables. Links of length h = 1/n, with half a link at either end, are joined by
balls of stiffness 1/h; the first half link is clamped. The sphere moves instead of the base. Inertia and damping are
those of `hinge_chain`, contacts are harder; states that do not come to rest are NaN.
"""

import mujoco
import numpy as np

from peers.hinge_chain import MOST, STILL, THICKNESS
from peers.scene import InSpace


def model(scene: InSpace, links: int) -> mujoco.MjModel:
    """Upright chain with its base at the origin; ball joints in order from base to tip."""
    h, chain = 1 / links, ""
    for number in reversed(range(links + 1)):
        length = h if 0 < number < links else h / 2
        inside = f'<geom type="capsule" size="{THICKNESS}" fromto="0 0 0 0 {length} 0" mass="1e-3"/>{chain}'
        joint = f'<joint type="ball" stiffness="{links}" damping="{1.6 * links}" armature="{links}"/>' if number else ""
        above = 0 if number == 0 else h / 2 if number == 1 else h
        chain = f'<body pos="0 {above} 0">{joint}{inside}</body>'
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 0" timestep="0.1" integrator="implicitfast"/>
          <default><geom condim="1" solref="0.2 1" solimp="0.9999 0.9999 0.001" contype="1" conaffinity="2"/></default>
          <worldbody>
            <body mocap="true" pos="0 0 {-scene.offset}">
              <geom type="sphere" size="{scene.radius - THICKNESS}" contype="2" conaffinity="1"/>
            </body>
            {chain}
          </worldbody>
        </mujoco>""")


def scan(scene: InSpace, control: np.ndarray, links: int) -> np.ndarray:
    """Support reactions fx, fy, fz, mx, my, mz at every drive position, (steps, 6)."""
    chain = model(scene, links)
    data = mujoco.MjData(chain)
    reactions, wrench = [], np.zeros(6)
    for u in control:
        data.mocap_pos[0] = u, scene.height, -scene.offset
        for _ in range(MOST):
            mujoco.mj_step(chain, data)
            if np.max(np.abs(data.qvel)) < STILL:
                break
        else:
            reactions.append(np.full(6, np.nan))
            continue
        mujoco.mj_forward(chain, data)
        reaction = np.zeros(6)
        for number, contact in enumerate(data.contact):
            mujoco.mj_contactForce(chain, data, number, wrench)
            push = wrench[0] * contact.frame[:3]  # along the normal from sphere to chain
            reaction -= np.append(push, np.cross(contact.pos, push))
        reactions.append(reaction)
    return np.array(reactions)
