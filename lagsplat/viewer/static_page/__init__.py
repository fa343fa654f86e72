"""One HTML page that simulates a fitted run without a server or a network.

`build` packs the law and the Gaussians (`pack_page`) and writes the page (`save_page`); `assets/` holds its
JavaScript, style and HTML.
"""
