"""Rollouts by the classical Runge-Kutta method, alone and together with their derivatives."""
