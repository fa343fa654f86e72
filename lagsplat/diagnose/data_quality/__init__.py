"""What is known of the recordings before anything is fitted: errors in them, noise, period and excitation.

`checks` runs everything (`check_data`, `DataCheck`): `compatibility`, `discontinuities`, `sampling`,
`closed_loop` and `time_alignment` give findings; `natural_period` (`estimate_natural_period_s`), `noise`
(`measure_noise`, `MeasurementNoise`) and `excitation_measures` (`measure_excitation`) give numbers.
"""
