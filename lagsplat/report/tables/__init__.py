"""Tables of results, each as a data frame for CSV and as LaTeX, with the paper's numbers beside ours."""
