"""The report of a diagnosis: its files, its figures, its summary in words, and one page that holds them all.

Public: `serialization.save_diagnosis`, `serialization.load_diagnosis`, `content.save_rollouts`,
`html.render_report`, `summary.write_summary`.
"""
