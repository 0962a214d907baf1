"""Exudyn: a cable of ANCF elements in contact with circles, solved by its static solver.

Segments of each element press on a circle with a penalty. The circles move instead of the clamped base, in steps that
the solver shortens where it fails. States are NaN where it fails all the same.
"""

import exudyn as exu
import numpy as np
from exudyn.itemInterface import (
    MarkerBodyCable2DShape,
    MarkerBodyPosition,
    MarkerNodeCoordinate,
    NodeGenericData,
    NodePoint2DSlope1,
    NodePointGround,
    ObjectANCFCable2D,
    ObjectConnectorCoordinate,
    ObjectContactCircleCable2D,
    ObjectGround,
)

from peers.scene import Circles

TOLERANCE = 1e-6  # of forces in EI/L^2; rounding does not allow much less in stiff cables
SEGMENTS = 12  # contacts of an element with a circle; Exudyn's limit


def _built(scene: Circles, elements: int, axial: float, penalty: float):
    """The system, its constraints of x, y and slope at the base, and the body of the circles."""
    container = exu.SystemContainer()
    system = container.AddSystem()
    h = 1 / elements
    ground = system.AddMarker(MarkerNodeCoordinate(nodeNumber=system.AddNode(NodePointGround()), coordinate=0))
    nodes = [system.AddNode(NodePoint2DSlope1(referenceCoordinates=[0, k * h, 0, 1])) for k in range(elements + 1)]
    own = {"length": h, "massPerLength": 1.0, "bendingStiffness": 1.0, "axialStiffness": axial}
    cables = [system.AddObject(ObjectANCFCable2D(**own, nodeNumbers=[nodes[k], nodes[k + 1]])) for k in range(elements)]
    held = []
    for coordinate in (0, 1, 2):
        marker = system.AddMarker(MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate))
        held.append(system.AddObject(ObjectConnectorCoordinate(markerNumbers=[ground, marker])))
    body = system.AddObject(ObjectGround())
    for x, y, radius in scene.circles:
        centre = system.AddMarker(MarkerBodyPosition(bodyNumber=body, localPosition=[x, y, 0]))
        for cable in cables:
            shape = system.AddMarker(MarkerBodyCable2DShape(bodyNumber=cable, numberOfSegments=SEGMENTS))
            gaps = NodeGenericData(initialCoordinates=[0.1] * SEGMENTS, numberOfDataCoordinates=SEGMENTS)
            system.AddObject(
                ObjectContactCircleCable2D(
                    markerNumbers=[centre, shape],
                    nodeNumber=system.AddNode(gaps),
                    numberOfContactSegments=SEGMENTS,
                    contactStiffness=penalty,
                    circleRadius=radius,
                )
            )
    system.Assemble()
    return container, system, held, body


def scan(scene: Circles, control: np.ndarray, elements: int, axial: float, penalty: float) -> np.ndarray:
    """Support reactions fx, fy, mz at every drive position, (steps, 3)."""
    _container, system, held, body = _built(scene, elements, axial, penalty)
    drive = [control[0], control[0]]  # from here to there in one call

    def place(system, share):
        u = drive[0] + share * (drive[1] - drive[0])
        return system.SetObjectParameter(body, "referencePosition", [-u, 0, 0]) or True

    system.SetPreStepUserFunction(place)
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    static = settings.staticSolver
    static.verboseMode = 0
    static.numberOfLoadSteps = 1  # before it shortens them
    static.newton.absoluteTolerance = static.newton.relativeTolerance = TOLERANCE
    static.newton.maxIterations = 50
    static.discontinuous.maxIterations = 30
    static.discontinuous.ignoreMaxIterations = False
    reactions = []
    for u in control:
        drive[1] = float(u)
        try:
            found = system.SolveStatic(settings, updateInitialValues=True)
        except exu.SolverError:
            found = False
        if found:
            drive[0] = drive[1]
            force = [np.ravel(system.GetObjectOutput(one, exu.OutputVariableType.Force))[0] for one in held]
            reactions.append((force[0], force[1], -force[2]))
        else:
            reactions.append((np.nan,) * 3)
    return np.array(reactions)
