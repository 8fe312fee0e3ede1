"""Views of a diagnosis: text, data, pictures and a page."""
