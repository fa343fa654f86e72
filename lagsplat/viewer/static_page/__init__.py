"""One HTML page that simulates a fitted run without a server or a network (`save_page`)."""
