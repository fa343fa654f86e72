"""The catalogue of effects that a simulation may lack, one file each.

`base` says what an effect is (`ForceEffect` and its sisters), `parameters` how its parameters are counted and
what is believed of them, and `registry` has `catalogue` and `register_effect`.
"""
