"""Macro scale: it talks to a :class:`femxdem_fenicsx.law.Law` and never sees a grain."""
