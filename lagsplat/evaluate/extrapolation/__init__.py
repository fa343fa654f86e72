"""How well a model forecasts far past its training clip, in images and in states."""
