"""The Kalman filter and smoother of a mechanism under a random torque.

`grid` lays recordings out as instants, `law` evaluates an effect and its slopes along a motion,
`linearised` makes one linear step of the model between two instants, `kalman` filters and smooths
the linear system, `trajectory` repeats that until model and smoothed motion agree.
"""
