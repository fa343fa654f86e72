"""The room `static_page`."""
