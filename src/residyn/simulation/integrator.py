"""Integrators: residyn's own fixed steps, or any solver of diffrax.

A fit integrates Eq. 1 hundreds of times over nearly the same path. By default it takes fixed steps
in a plain loop (`simulation`), the quickest way to compile and to differentiate. An `Integrator`
hands the same equation to `diffrax.diffeqsolve` instead, with a solver, tolerances, a step-size
controller and an adjoint of the user's.

Whoever integrates, readings are taken from the same curve: a quintic through angle, rate and
acceleration at evenly spaced instants, the *nodes*. So a solver that chooses its own steps is made
to end a step at every node; between two nodes it may take as many as it needs. Where a drive torque
jumps, at a node, the step ends just before it and the next one begins just after.

Dry friction is no differential equation in the usual sense: its torque jumps where a joint
reverses, and holds the joint at rest at no definite value. `StickSlip` steps resolve that. A solver
that knows the torque's value only would chatter there, so it is refused.
"""

import dataclasses
from typing import Any, ClassVar

import diffrax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import InputError, number, quote
from ..physics.model import Model
from ..physics.motion import split, stack
from .equation import Args, Piecewise, rates
from .stepping import State, dry_step, smooth_step

FIXED, STICK_SLIP = "fixed", "StickSlip"
ADAPTIVE = (
    "Bosh3",
    "Dopri5",
    "Dopri8",
    "Heun",
    "ImplicitEuler",
    "Kvaerno3",
    "Kvaerno4",
    "Kvaerno5",
    "Midpoint",
    "Ralston",
    "Tsit5",
)
"""Solvers of diffrax for ordinary differential equations that estimate their own error."""

_FORWARD = (diffrax.ForwardMode, diffrax.DirectAdjoint)
_STEPS_EACH = 4  # between two nodes, at most, in the mean


class UnrolledTsit5(diffrax.AbstractSolver):
    """Tsitouras 5(4) with its stages written out and no error estimate, for fixed steps.

    For diffrax: `y = (q, v, z)`, and the args of the solve are an equation's `Args`.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation
    advance: ClassVar = staticmethod(smooth_step)

    def order(self, terms):
        return 5

    def init(self, terms, t0, t1, y0, args):
        return None

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        args = _within(args, 0.5 * (t0 + t1))
        y1 = arrays_of(self.advance(args, t0, t1 - t0, tuples_of(y0))[0])
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful


class StickSlip(UnrolledTsit5):
    """`UnrolledTsit5` for joints with dry friction: see `stepping`."""

    advance: ClassVar = staticmethod(dry_step)


@dataclasses.dataclass(frozen=True)
class Integrator:
    """A diffrax solver, and how it is to be used.

    **Arguments:**

    - `solver`: a name (`"Tsit5"`, `"Dopri8"`, `"Kvaerno5"`, ...: all are in
      `residyn.simulation.integrator.ADAPTIVE`; or `"StickSlip"`, residyn's own step) or an
      instance, such as `diffrax.Tsit5()`. `"fixed"` is residyn's loop of fixed steps.
    - `rtol`, `atol`: relative and absolute tolerance of one step (absolute: rad, rad/s; m, m/s).
    - `controller`: a step-size controller of diffrax that adapts; None is `PIDController(rtol,
      atol)`.
    - `adjoint`: how diffrax differentiates; None is what suits the use: `ForwardMode` in a fit and
      in an embedded one, which then has no reverse mode (`DirectAdjoint` has both, but takes
      minutes to compile), `RecursiveCheckpointAdjoint` in `simulate`.
    - `max_steps`: steps after which an integration is given up.

    **Raises:** `InputError` for a name that is no solver's, a tolerance that is no positive number,
    a solver without an error estimate, or one that holds arrays (it is a part of a compiled
    program's name).
    """

    solver: Any = "Tsit5"
    rtol: float = 1e-8
    atol: float = 1e-10
    controller: Any = None
    adjoint: Any = None
    max_steps: int = 100_000

    def __post_init__(self):
        if isinstance(self.solver, str):
            if self.solver not in (FIXED, STICK_SLIP, *ADAPTIVE):
                known = ", ".join((FIXED, STICK_SLIP, *ADAPTIVE))
                raise InputError(
                    f"solver = {quote(self.solver)}: there is no such solver; it must be one of "
                    f"{known}"
                )
        elif not isinstance(self.solver, diffrax.AbstractSolver):
            raise InputError(
                f"solver = {quote(self.solver)}: must be a name or a diffrax solver such as "
                "diffrax.Tsit5()"
            )
        elif not isinstance(self.solver, (UnrolledTsit5, diffrax.AbstractAdaptiveSolver)):
            raise InputError(
                f"solver = {self.name}: it estimates no error, so nothing can choose its steps; "
                "take one that does, such as Tsit5"
            )
        number("rtol", self.rtol, "relative", above=0.0)
        number("atol", self.atol, "absolute", above=0.0)
        adaptive = diffrax.AbstractAdaptiveStepSizeController
        if self.controller is not None and not isinstance(self.controller, adaptive):
            raise InputError(
                f"controller = {type(self.controller).__name__}: must adapt the step, as "
                "diffrax.PIDController does"
            )
        if self.adjoint is not None and not isinstance(self.adjoint, diffrax.AbstractAdjoint):
            raise InputError(f"adjoint = {quote(self.adjoint)}: must be an adjoint of diffrax")
        if isinstance(self.max_steps, bool) or not self.max_steps >= 1:
            raise InputError(f"max_steps = {self.max_steps}: must be at least 1")
        try:
            hash(self)
        except TypeError:
            raise InputError(
                f"solver = {self.name}: its settings and its controller's must be plain numbers, "
                "not arrays"
            ) from None

    def __repr__(self):
        """All of it in words, if words can tell it; what cannot be told begins with `<`."""
        if isinstance(self.solver, str) and self.controller is None and self.adjoint is None:
            return f"Integrator({self.solver}, {self.rtol!r}, {self.atol!r}, {self.max_steps})"
        return f"<Integrator {self.name}>"

    @property
    def name(self) -> str:
        """The solver's name."""
        return self.solver if isinstance(self.solver, str) else type(self.solver).__name__

    @property
    def adapts(self) -> bool:
        """Whether the solver chooses its steps; otherwise one leads from node to node."""
        return not isinstance(self.made(), UnrolledTsit5)

    def made(self) -> diffrax.AbstractSolver:
        """The solver itself."""
        if not isinstance(self.solver, str):
            return self.solver
        return StickSlip() if self.solver == STICK_SLIP else getattr(diffrax, self.solver)()

    def check(self, model: Model) -> None:
        """**Raises:** `InputError` if the solver cannot integrate an effect of the model."""
        if isinstance(self.made(), StickSlip):
            return
        for effect in model.effects:
            if effect.dry:
                why = (
                    "its torque jumps where a joint reverses and may hold it at rest, which takes "
                    "stick-slip steps"
                )
            elif effect.follows and not isinstance(self.made(), UnrolledTsit5):
                why = "its memory follows the angle from step to step and has no rate"
            else:
                continue
            raise InputError(
                f"integrator {self.name} cannot integrate {effect.label}: {why}; leave it at "
                f'"{FIXED}", or take {STICK_SLIP}'
            )

    def check_forward(self) -> None:
        """**Raises:** `InputError` for an adjoint that no fit can use."""
        if self.adjoint is not None and not isinstance(self.adjoint, _FORWARD):
            raise InputError(
                f"adjoint = {type(self.adjoint).__name__}: a fit takes Jacobians in forward mode, "
                "for which diffrax has ForwardMode and DirectAdjoint"
            )


def integrator_of(given: "Integrator | diffrax.AbstractSolver | str | None") -> Integrator | None:
    """What a user gives as `integrator=`; None for fixed steps.

    **Raises:** `InputError` as `Integrator`.
    """
    if given is None or given == FIXED:
        return None
    found = given if isinstance(given, Integrator) else Integrator(given)
    return None if found.solver == FIXED else found


def at_nodes(
    integrator: Integrator,
    args: Args,
    y: State,
    nodes: Float[Array, " M+1"],
    adjoint: diffrax.AbstractAdjoint,
    tighter: Float[Array, ""] | float = 1.0,
) -> tuple[Array, Array, Array]:
    """The state (q, v, z) at every node, by `diffrax.diffeqsolve`.

    `nodes` grow, and may end in copies of the last instant. `tighter` divides the tolerances and
    may be traced.
    """
    solver = integrator.made()
    if isinstance(solver, UnrolledTsit5):
        controller = _OneStepEach(nodes)
    else:
        inner = integrator.controller or diffrax.PIDController(
            rtol=integrator.rtol / tighter, atol=integrator.atol / tighter
        )
        steps, jumps = (None, nodes) if isinstance(args.drive, Piecewise) else (nodes, None)
        controller = diffrax.ClipStepSizeController(inner, steps, jumps)
    # What reverse mode goes back over is compiled in: it must be no more than is needed.
    most = integrator.max_steps
    if isinstance(adjoint, diffrax.DirectAdjoint):
        most = min(most, _STEPS_EACH * nodes.shape[0])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(vector_field),
        solver,
        nodes[0],
        nodes[-1],
        None,
        arrays_of(y),
        args=args,
        saveat=diffrax.SaveAt(ts=nodes),
        stepsize_controller=controller,
        adjoint=adjoint,
        max_steps=most,
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys


def vector_field(t, y, args: Args):
    """(q', v', z') for diffrax."""
    motion = tuples_of(y).motion(t)
    a, z = rates(_within(args, t), motion)
    return arrays_of(State(motion.v, a, z))


def _within(args: Args, t) -> Args:
    """The equation in the step in which an instant lies."""
    drive = args.drive
    if not isinstance(drive, Piecewise):
        return args
    last = drive.left.shape[0] - 1
    index = jnp.clip(jnp.floor((t - drive.start) / drive.spacing).astype(int), 0, last)
    # As `nodes` were rounded, so that an instant just before one is before it here, too.
    index = jnp.where(t < drive.start + index * drive.spacing, index - 1, index)
    index = jnp.where(t >= drive.start + (index + 1) * drive.spacing, index + 1, index)
    return args._replace(drive=drive.during(jnp.clip(index, 0, last)))


def arrays_of(y: State) -> tuple[Array, Array, Array]:
    """A state as diffrax holds it."""
    return stack(y.q), stack(y.v), stack(y.z) if y.z else jnp.zeros(0)


def tuples_of(y) -> State:
    """The inverse of `arrays_of`."""
    return State(*map(split, y))


# -- step-size controllers -------------------------------------------------------------------


def _next_node(nodes, t):
    """The first node after an instant; the last one if there is none."""
    index = jnp.searchsorted(nodes, t, side="right")
    return nodes[jnp.minimum(index, nodes.shape[0] - 1)]


class _OneStepEach(diffrax.AbstractStepSizeController):
    """Steps from node to node."""

    nodes: Float[Array, " M"]

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return _next_node(self.nodes, t0), None

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        there = _next_node(self.nodes, t1)
        return True, t1, there, False, None, diffrax.RESULTS.successful
