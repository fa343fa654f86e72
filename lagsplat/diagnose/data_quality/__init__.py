"""What is known of the recordings before anything is fitted: errors in them, noise, period and excitation.

`checks` runs everything: `compatibility`, `discontinuities`, `sampling` and `input_checks` give findings;
`natural_period`, `noise` and `excitation_measures` give numbers.
"""
