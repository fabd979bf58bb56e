"""Tables and figures of published papers, reproduced with the package's public functions."""
