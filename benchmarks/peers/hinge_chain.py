"""MuJoCo: a chain of hinges that relaxes to rest at each drive position, the usual whisker model in robot simulators.

Rigid links of length h = 1/n, with half a link at either end, are joined by hinges of stiffness 1/h; the base slides on
its spring. The object is a sphere, for which MuJoCo's contact with capsules is exact; in the plane of its centre it is
the circle. Only the state at rest counts, so the inertia (armature) makes all hinges equally fast and damping is nearly
critical. Contact next to a hinge may flicker; states that do not come to rest are NaN.
"""

import mujoco
import numpy as np

from peers.scene import Circle

THICKNESS = 1e-3  # radius of the capsules; the radius of the sphere is reduced by the same amount
STILL = 1e-7  # largest velocity at rest; the hinges have a period of 2 pi
MOST = 1000  # time steps


def model(scene: Circle, links: int) -> mujoco.MjModel:
    """Upright chain; joints in order: slide of the base, hinges from base to tip."""
    h = 1 / links
    chain = ""
    for number in reversed(range(links + 1)):
        length = h if 0 < number < links else h / 2
        inside = f'<geom type="capsule" size="{THICKNESS}" fromto="0 0 0 0 {length} 0" mass="1e-3"/>{chain}'
        joint = f'<joint axis="0 0 1" stiffness="{links}" damping="{1.6 * links}" armature="{links}"/>'
        if number == 0:
            k = scene.stiffness
            joint = f'<joint type="slide" axis="1 0 0" stiffness="{k}" damping="{1.6 * k}" armature="{k}"/>'
        above = 0 if number == 0 else h / 2 if number == 1 else h
        chain = f'<body pos="0 {above} 0">{joint}{inside}</body>'
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 0" timestep="0.1" integrator="implicitfast"/>
          <default><geom condim="1" solref="0.4 1" solimp="0.999 0.999 0.001" contype="1" conaffinity="2"/></default>
          <worldbody>
            <geom type="sphere" size="{scene.radius - THICKNESS}" pos="0 {scene.distance + scene.radius} 0"
                  contype="2" conaffinity="1"/>
            {chain}
          </worldbody>
        </mujoco>""")


def scan(scene: Circle, control: np.ndarray, links: int) -> np.ndarray:
    """Support reactions fx, fy, mz at every drive position, (steps, 3)."""
    chain = model(scene, links)
    data = mujoco.MjData(chain)
    data.qpos[0] = control[0] + scene.rest_length
    reactions, wrench = [], np.zeros(6)
    for u in control:
        chain.qpos_spring[0] = u + scene.rest_length
        for _ in range(MOST):
            mujoco.mj_step(chain, data)
            if np.max(np.abs(data.qvel)) < STILL:
                break
        else:
            reactions.append((np.nan,) * 3)
            continue
        mujoco.mj_forward(chain, data)
        fx = fy = mz = 0.0
        for number, contact in enumerate(data.contact):
            mujoco.mj_contactForce(chain, data, number, wrench)
            push = wrench[0] * contact.frame[:2]  # along the normal from sphere to chain
            fx, fy = fx - push[0], fy - push[1]
            mz -= (contact.pos[0] - data.qpos[0]) * push[1] - contact.pos[1] * push[0]
        reactions.append((fx, fy, mz))
    return np.array(reactions)
