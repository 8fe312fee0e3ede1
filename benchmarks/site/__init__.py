"""The boards and comparisons of a results folder as static pages that fetch nothing."""
