"""The interactive simulation itself: stepping, grasping, energy balance and history.

`session` holds the state and takes commands (`Session`), `realtime_loop` keeps it in time with the clock,
`grasp` turns a drag into a force and balances the energy, and `history` records what happened.
"""
