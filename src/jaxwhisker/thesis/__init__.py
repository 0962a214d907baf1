"""Tables, figures and claims of the thesis, computed with jaxwhisker."""
