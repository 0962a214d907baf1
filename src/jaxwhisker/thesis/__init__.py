"""Tables, figures and claims of the thesis, computed again."""
