"""Tables of results, each as a data frame for CSV and as LaTeX, with the paper's numbers beside ours.

Each module builds rows (``build_..._rows``), a table (``build_..._table``) and LaTeX (``format_..._latex``).
"""
