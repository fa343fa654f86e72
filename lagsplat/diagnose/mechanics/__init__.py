"""The mechanical model of a simulator: mass, damping, potential and input map in one basis of functions.

`basis` has the functions (`Basis`), `model` the equations of motion (`MechanicalModel`, and the protocol
`Mechanics` of whatever can be asked for accelerations), `structure` the sizes that each field may have
(`ModelStructure`).
"""
