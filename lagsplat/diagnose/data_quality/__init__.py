"""What is known of the recordings before anything is fitted: errors in them, noise and period.

`checks` runs everything: `compatibility`, `discontinuities`, `sampling` and `input_checks` give findings;
`natural_period` and `noise` give numbers.
"""
