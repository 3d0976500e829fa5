"""mujoco.sysid: MuJoCo's own toolbox, on MuJoCo's own arm.

It differentiates rollouts by finite differences. Its rollouts start from a given state; a rollout
of our own, which it provides for, takes that from the unknowns.
"""

import contextlib
import io
import time

import numpy as np

from ._rivals_problem import DT, Answer, Missing, Problem, TooSlow

try:
    import mujoco
    from mujoco import sysid

    sysid.optimize  # noqa: B018  the module is there even when what it needs is not
except (ImportError, AttributeError) as error:
    raise Missing("mujoco[sysid]") from error

JOINTS = ("shoulder", "elbow")


def specification(given: Problem) -> mujoco.MjSpec:
    """The arm, stepped by RK4 at the sampling interval, with sensors of both angles."""
    spec = mujoco.MjSpec.from_string(given.arm.mjcf())
    spec.option.timestep = DT
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in JOINTS:
        spec.add_sensor(
            name=f"{name} angle",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    return spec


def unknowns(given: Problem) -> sysid.ParameterDict:
    """The four numbers, and each recording's initial state."""
    found = sysid.ParameterDict()

    def joint(field, name):
        def modify(spec, parameter):
            values = getattr(spec.joint(name), field)
            value = float(parameter.value[0])
            if np.ndim(values):
                values[0] = value
            else:
                setattr(spec.joint(name), field, value)

        return modify

    fields = [("stiffness", n) for n in JOINTS] + [("damping", n) for n in JOINTS]
    for (field, name), value in zip(fields, given.start, strict=True):
        key = f"{name} {field}"
        found.add(sysid.Parameter(key, value, 0.1 * value, 10 * value, modifier=joint(field, name)))
    for r, state in enumerate(given.states):
        for i, value in enumerate(state):
            key = f"state {r} {i}"
            found.add(sysid.Parameter(key, value, value - 1, value + 1, modifier=lambda s, p: None))
    return found


def fit(given: Problem, optimizer: str = "mujoco") -> Answer:
    """`sysid.optimize` from 40 % off; its own optimizer is the default."""
    spec, parameters = specification(given), unknowns(given)
    model, count = spec.compile(), len(given.t)
    still = sysid.TimeSeries(given.t, np.zeros((count, 0)))

    def residual_of(r: int):
        def start(params) -> np.ndarray:
            return np.array([params[f"state {r} {i}"].value[0] for i in range(4)])

        def rollout(param_dicts, initial_states, **rest):
            states = [start(p) for p in param_dicts]
            states = [sysid.create_initial_state(model, y[:2], y[2:]) for y in states]
            return sysid.sysid_rollout(initial_states=states, **rest)

        def whitened(params, predicted, measured, model, return_all, state, **rest):
            # Rolled-out sensors lag one step behind the states, so the states are compared; they
            # begin after the first step.
            angles = np.vstack([start(params)[:2], state[:, 1:3]])
            return (angles - given.q[r]) / given.noise, measured, measured

        readings = sysid.TimeSeries.from_names(given.t, given.q[r], model)
        first = sysid.create_initial_state(model, given.q[r, 0])
        return sysid.build_residual_fn(
            models_sequences=[
                sysid.ModelSequences("arm", spec, f"release {r}", first, still, readings)
            ],
            modify_residual=whitened,
            custom_rollout=rollout,
            resample_true=False,
        )

    each = [residual_of(r) for r in range(len(given.q))]

    def residual(x, params):
        if time.perf_counter() - began > given.limit:
            raise TooSlow
        return [part for one in each for part in one(x, params)[0]], None, None

    began = time.perf_counter()
    # It prints every step, and has no way to tell it not to.
    with contextlib.redirect_stdout(io.StringIO()):
        found, _ = sysid.optimize(parameters, residual, optimizer, verbose=False, x_scale="jac")
    x = found.as_vector()
    return Answer(x[:4], x[4:].reshape(-1, 4))


def fit_scipy(given: Problem) -> Answer:
    """The same with the optimizer that the toolbox borrows from SciPy."""
    return fit(given, "scipy_parallel_fd")
