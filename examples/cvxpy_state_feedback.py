"""State feedback for gyro 9-10 by a convex problem written out with cvxpy: closed, judged, drawn (to a FILE.png)."""

import sys
import tomllib
from pathlib import Path

import control
import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc

# Loop 9-10 of the main job with one of its designs.
job = tomllib.loads((Path(__file__).parent / "three_gyro_platform.toml").read_text(encoding="utf-8"))
spec = next(one for one in job["loop"] if one["name"] == "caging 9-10")
spec |= {"use": "H-infinity", "design": [one for one in spec["design"] if one["name"] == "H-infinity"]}
without = ("coupled", "campaign", "manoeuvre", "fault")
loop = pc.design.loops({key: x for key, x in job.items() if key not in without} | {"loop": [spec]})[0]

# The exactly sampled plant with delay and lag, torques in units of 0.05 N m, and the integrals of both angles in mrad.
plant = loop.closed.plant[["alpha9", "beta10"], ["Q9", "Q10"]]
A = np.block([[plant.A, np.zeros((len(plant.A), 2))], [1e3 * plant.dt * plant.C, np.eye(2)]])
B = np.vstack([0.05 * plant.B, np.zeros((2, 2))])
n, decay = len(A), np.exp(-50.0 * plant.dt)
C = np.zeros((4, n))  # angles in units of 0.2 mrad, their integrals in units of 0.02 mrad s
C[:2, : n - 2], C[2:, n - 2 :] = 5e3 * plant.C, 50.0 * np.eye(2)
R = np.linalg.cholesky(control.dlqr(A, B, C.T @ C, np.eye(2))[1]).T  # in the states R x, Q is near one
A, B, C = R @ A @ np.linalg.inv(R), R @ B, C @ np.linalg.inv(R)

# u = L Q⁻¹ x: least H2 norm from torque disturbances to C x and u, while every pole decays at 50 1/s at least.
Q, L, W = cp.Variable((n, n), symmetric=True), cp.Variable((2, n)), cp.Variable((6, 6), symmetric=True)
z, after = cp.vstack([C @ Q, L]), A @ Q + B @ L
outputs, steady = cp.bmat([[W, z], [z.T, Q]]) >> 0, cp.bmat([[Q - B @ B.T, after], [after.T, Q]]) >> 0
poles = cp.bmat([[decay * Q, after], [after.T, decay * Q]]) >> 0
problem = cp.Problem(cp.Minimize(cp.trace(W)), [outputs, steady, poles])
problem.solve(solver=cp.CLARABEL)
K = 0.05 * np.linalg.solve(Q.value, L.value.T).T @ R
print(f"cvxpy: {problem.status}, H2 norm {np.sqrt(problem.value):.3f}")

# The states from the pick-offs by a Kalman filter: torque disturbances of 3 mN m, noise of 5 µrad.
H, F, G = plant.C, K[:, : n - 2], K[:, n - 2 :]
gain = control.dlqe(plant.A, plant.B, H, 9e-6 * np.eye(2), 25e-12 * np.eye(2))[0]
update = np.eye(n - 2) - gain @ H  # of the predicted states by the present sample
A_K = np.block([[(plant.A + plant.B @ F) @ update, plant.B @ G], [np.zeros((2, n - 2)), np.eye(2)]])
B_K = np.vstack([(plant.A + plant.B @ F) @ gain, 1e3 * plant.dt * np.eye(2)])
names = {"inputs": ["alpha9", "beta10"], "outputs": ["Q9", "Q10"]}
found = control.ss(A_K, B_K, np.hstack([F @ update, G]), F @ gain, plant.dt, **names)
closed = pc.design.with_controller(loop, found, name="cvxpy")
for one in closed.closed.results:
    value, limit = (f"{x:.3g} {one.unit}".rstrip() for x in (one.value, one.limit))
    print(f"{one.name}: {value}, {one.sense} {limit}: {'met' if one.passed else 'not met'}")
hz = np.geomspace(1.0, 990.0, 600)
figure, axes = plt.subplots()
for design in closed.designs:
    L = pc.analysis.loop_transfer(plant, design.controller, at="output")
    S = np.linalg.inv(np.eye(2) + np.moveaxis(pc.analysis.frequency_response(L, 2.0 * np.pi * hz), -1, 0))
    axes.loglog(hz, np.linalg.norm(S, 2, axis=(1, 2)), label=design.name)
axes.set(xlabel="frequency, Hz", ylabel="largest singular value of S")
axes.legend()
figure.savefig(sys.argv[1]) if sys.argv[1:] else plt.show()
