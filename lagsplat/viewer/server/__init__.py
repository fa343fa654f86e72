"""The live view in a browser, on viser (`ViewerServer`), and the export of a session."""
