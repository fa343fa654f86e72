"""What tables, figures and pages share: number formats, table rows, the paper's values and the figure style.

Public: `formatting.format_number`, `table_rows.build_rows`, `style.new_figure`, `style.save_figure`.
"""
