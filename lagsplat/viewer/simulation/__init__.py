"""The interactive simulation itself (`Session`), in real time (`RealtimeLoop`)."""
