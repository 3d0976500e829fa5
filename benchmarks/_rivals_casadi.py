"""CasADi: RK4 with exact derivatives and IPOPT, in single and in multiple shooting.

The solver of a problem's shape is built once; a warm fit calls it with other readings.
"""

import contextlib
import functools
import shutil
import tempfile
import time

import numpy as np

from ._rivals_problem import Answer, Missing, Problem

try:
    import casadi as ca
except ImportError as error:
    raise Missing("casadi") from error

OPTIONS = {
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 200,
    "ipopt.tol": 1e-8,
    "print_time": False,
}
if shutil.which("gcc"):  # three times faster in multiple shooting, 1.2 times in single shooting
    OPTIONS |= {
        "jit": True,
        "compiler": "shell",
        "jit_options": {"flags": ["-O2"], "cleanup": False},
        "jit_cleanup": False,  # its files go with the folder
    }


def step(inertia: tuple[float, ...], dt: float) -> ca.Function:
    """One RK4 step of Eq. 1: (state, k1 k2 c1 c2) to the next state."""
    x, p = ca.SX.sym("x", 4), ca.SX.sym("p", 4)
    shoulder, d, s, theta2 = inertia

    def rate(y):
        q1, q2, v1, v2 = ca.vertsplit(y)
        cross, bend = s * ca.cos(theta2 + q2), s * ca.sin(theta2 + q2)
        a, b = shoulder + d + 2 * cross, d + cross
        f1 = bend * v2 * (2 * v1 + v2) - p[0] * q1 - p[2] * v1
        f2 = -bend * v1 * v1 - p[1] * q2 - p[3] * v2
        det = a * d - b * b
        return ca.vertcat(v1, v2, (d * f1 - b * f2) / det, (a * f2 - b * f1) / det)

    k1 = rate(x)
    k2 = rate(x + dt / 2 * k1)
    k3 = rate(x + dt / 2 * k2)
    k4 = rate(x + dt * k3)
    return ca.Function("step", [x, p], [x + dt / 6 * (k1 + 2 * (k2 + k3) + k4)])


@functools.cache
def multiple(inertia: tuple[float, ...], dt: float, recordings: int, count: int):
    """A solver with every sample's state among the unknowns. The residual is linear in them, so
    the Gauss-Newton Hessian is constant."""
    one = step(inertia, dt)
    p, sizes = ca.MX.sym("p", 4), ca.MX.sym("sizes", 4)
    states = [ca.MX.sym(f"x{r}", 4, count) for r in range(recordings)]
    readings = ca.MX.sym("q", 2, count * recordings)
    sigma = ca.MX.sym("sigma")
    gaps = [
        ca.vec(one.map(count - 1)(x[:, :-1], ca.repmat(p * sizes, 1, count - 1)) - x[:, 1:])
        for x in states
    ]
    misfit = ca.vec(ca.horzcat(*[x[:2, :] for x in states]) - readings) / sigma
    unknowns = ca.veccat(p, *states)
    given = ca.veccat(sizes, sigma, readings)
    gap = ca.vertcat(*gaps)
    diagonal = ca.vertcat(ca.DM.zeros(4), ca.repmat(ca.DM([1, 1, 0, 0]), count * recordings, 1))
    weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", gap.shape[0])
    hessian = ca.Function(
        "hessian",
        [unknowns, given, weight, multipliers],
        [ca.diag(ca.sparsify(diagonal)) * (weight / sigma**2)],
    )
    nlp = {"x": unknowns, "p": given, "f": 0.5 * ca.dot(misfit, misfit), "g": gap}
    return ca.nlpsol("multiple", "ipopt", nlp, {**OPTIONS, "hess_lag": hessian})


@functools.cache
def single(inertia: tuple[float, ...], dt: float, recordings: int, count: int):
    """A solver with the initial states alone among the unknowns."""
    run = step(inertia, dt).mapaccum(count - 1)
    p, sizes = ca.MX.sym("p", 4), ca.MX.sym("sizes", 4)
    states = ca.MX.sym("x", 4, recordings)
    readings = ca.MX.sym("q", 2, count * recordings)
    sigma = ca.MX.sym("sigma")
    parts = []
    for r in range(recordings):
        x = states[:, r]
        parts.append(ca.horzcat(x, run(x, ca.repmat(p * sizes, 1, count - 1)))[:2, :])
    misfit = ca.vec(ca.horzcat(*parts) - readings) / sigma
    unknowns, given = ca.veccat(p, states), ca.veccat(sizes, sigma, readings)
    slopes = ca.jacobian(misfit, unknowns)
    weight, none = ca.MX.sym("weight"), ca.MX.sym("none", 0)
    hessian = ca.Function(
        "hessian", [unknowns, given, weight, none], [weight * ca.triu(slopes.T @ slopes)]
    )
    nlp = {"x": unknowns, "p": given, "f": 0.5 * ca.dot(misfit, misfit)}
    return ca.nlpsol("single", "ipopt", nlp, {**OPTIONS, "hess_lag": hessian})


def fit(given: Problem, build=multiple) -> Answer:
    """Multiple shooting, the states begun at the readings and their differences."""
    began = time.perf_counter()
    dt = float(given.t[1] - given.t[0])
    # It compiles in the working directory.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        solver = build(tuple(given.inertia.tolist()), dt, *given.q.shape[:2])
    built = time.perf_counter()
    if build is multiple:
        speed = np.gradient(given.q, dt, axis=1)
        states = np.concatenate([given.q, speed], axis=2)
    else:
        states = given.states
    first = np.concatenate([np.ones(4), states.ravel()])
    readings = np.concatenate([given.start, [given.noise], given.q.ravel()])
    edge = {"lbg": 0.0, "ubg": 0.0} if build is multiple else {}
    low = np.concatenate([np.full(4, 0.01), np.full(states.size, -np.inf)])
    out = solver(x0=first, p=readings, lbx=low, **edge)
    found = np.asarray(out["x"]).ravel()
    states = found[4:].reshape(len(given.q), -1, 4)[:, 0]
    seconds = {"building": built - began, "solving": time.perf_counter() - built}
    return Answer(found[:4] * given.start, states, seconds)


def fit_single(given: Problem) -> Answer:
    """Single shooting, Gauss-Newton."""
    return fit(given, single)
