"""Rollouts by the classical Runge-Kutta method, alone and together with their derivatives.

`runge_kutta` rolls out many sets of parameters over many windows, compiled (`roll_out_batch`), and holds the
step of the same method for any NumPy function (`take_runge_kutta_step`); `runge_kutta_sensitivity` adds the
derivatives by coefficients and initial states (`roll_out_with_sensitivities`).
"""
