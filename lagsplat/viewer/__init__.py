"""The place to push the filmed object: an engine without a browser, a live server, and one self-contained
page."""
