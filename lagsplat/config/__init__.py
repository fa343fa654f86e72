"""The configuration: `schema.Config` types all of ``conf/``, and `compose.compose` reads it with overrides.

Public: `compose`, `rebuild`, `ConfigError`, `options`.
"""
