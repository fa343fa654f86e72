"""The interactive simulation of a fitted run: a live server, and one self-contained page.

`simulation` steps the law and keeps energy and history, `rendering` draws frames and overlays, `server`
serves them to a browser, and `static_page` writes the page, whose scripts are in `static_page/assets`.
"""
