"""Novel views of a recording by SHARP, an external tool, and their cache."""
