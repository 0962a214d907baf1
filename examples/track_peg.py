"""Track a peg that moves beside a whisker, with an extended Kalman filter on two measurement models.

python examples/track_peg.py

A straight whisker (L = EI = 1) touches a round peg of radius 0.2 L, parallel to z, which moves on a circle. Its base
measures fx, fy and mz with noise of 1 % of their peaks. The filter knows neither the place nor the velocity of the peg.
The models are exact statics (`jw.MeasurementModel`) and a chain of rigid links with torsion springs at its joints.
"""

from collections.abc import Callable

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from scipy.optimize import least_squares

import jaxwhisker as jw

RADIUS, NOISE, STEPS = 0.2, 0.01, 150
MEASURED = [0, 1, 5]  # fx, fy and mz
START = np.array([-0.1, 0.85])  # of the centre; the base is at the origin

Model = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # signals (3,) and derivatives (3, 2) at a place


def peg(x, y):
    """The whisker at rest before a peg at (x, y)."""
    body = jw.Cylinder(RADIUS, (x, y, 0.0), (0.0, 0.0, 1.0))
    return jw.SpaceScene(jw.Whisker(), body, rod=jw.ClosedForm())


def exact_model() -> Model:
    """Exact statics; each call starts from the contact of the last one."""
    model = jw.MeasurementModel(peg, ("x", "y"))
    contact = model.contact(START, np.array([0.6, 0.0]))

    def signals(place):
        nonlocal contact
        found = model(place, 0.0, contact)
        contact = found.contact
        return np.asarray(found.signals)[0, MEASURED], np.asarray(found.jacobian)[0, MEASURED]

    return signals


def chain_model(links: int) -> Model:
    """A chain of rigid links on torsion springs of stiffness EI links / L, the first one with a joint at the base.

    It rests against the peg with one of its links, or with its tip.
    """
    size, stiffness, last = 1.0 / links, float(links), np.append(np.full(links, -0.02), 0.5)

    def equations(unknowns, place):
        """Moments at the joints, and the gap between chain and peg."""
        turn, force = np.cumsum(unknowns[:-1]), unknowns[-1]
        along = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
        joints = np.concatenate([np.zeros((1, 2)), np.cumsum(size * along, axis=0)])
        share = np.clip(np.sum((place - joints[:-1]) * along, axis=1), 0.0, size)
        closest = joints[:-1] + share[:, None] * along
        distance = np.linalg.norm(closest - place, axis=1)
        k = int(np.argmin(distance))
        push = force * (closest[k] - place) / distance[k]
        arm = closest[k] - joints[:-1]
        moment = np.where(np.arange(links) <= k, arm[:, 0] * push[1] - arm[:, 1] * push[0], 0.0)
        balance = np.append(stiffness * unknowns[:-1] - moment, distance[k] - RADIUS)
        return balance, np.array([-push[0], -push[1], -moment[0]])

    def at(place):
        nonlocal last
        last = least_squares(lambda unknowns: equations(unknowns, place)[0], last, xtol=1e-10).x
        return equations(last, place)[1]

    def signals(place):
        step, here = 1e-5, at(place)
        return here, np.stack([(at(place + step * way) - here) / step for way in np.eye(2)], axis=1)

    return signals


def places() -> np.ndarray:
    """The places of the peg, (steps, 2)."""
    angle = np.linspace(0.0, 2 * np.pi, STEPS)
    return START + 0.05 * np.stack([1 - np.cos(angle), np.sin(angle)], axis=1)


def track(model: Model, measured: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Places estimated by an extended Kalman filter with constant velocity, (steps, 2)."""
    state, covariance = np.array([*START + 0.01, 0.0, 0.0]), np.diag([0.02, 0.02, 0.003, 0.003]) ** 2
    onwards = np.eye(4) + np.eye(4, k=2)
    drift = np.diag([0.0, 0.0, 1e-4, 1e-4]) ** 2 * 4
    estimates = []
    for signals in measured:
        expected, by_place = model(state[:2])
        by = np.concatenate([by_place, np.zeros((3, 2))], axis=1)
        gain = covariance @ by.T @ np.linalg.inv(by @ covariance @ by.T + np.diag(sigma**2))
        state = state + gain @ (signals - expected)
        covariance = (np.eye(4) - gain @ by) @ covariance
        estimates.append(state[:2])
        state, covariance = onwards @ state, onwards @ covariance @ onwards.T + drift
    return np.array(estimates)


def errors(chains: tuple[int, ...] = (5, 10)) -> dict[str, float]:
    """Root mean square errors of the place in the last two thirds, in lengths, by model."""
    truth, model = places(), exact_model()
    signals = np.array([model(place)[0] for place in truth])
    sigma = NOISE * np.max(np.abs(signals), axis=0)
    measured = signals + sigma * np.random.default_rng(0).standard_normal(signals.shape)
    models = {"exact": exact_model()} | {f"chain of {links} links": chain_model(links) for links in chains}
    found = {name: track(model, measured, sigma) - truth for name, model in models.items()}
    return {name: float(np.sqrt(np.mean(np.sum(off[STEPS // 3 :] ** 2, axis=1)))) for name, off in found.items()}


if __name__ == "__main__":
    for name, error in errors().items():
        print(f"{name}: {error:.5f} L")
