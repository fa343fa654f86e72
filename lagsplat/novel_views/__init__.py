"""Novel views of a recording by SHARP, an external tool, and their cache.

`sharp` makes the views (`make_sharp_views`, `obtain_views`); `sharp_tool` runs and caches it (`SharpCache`).
"""
