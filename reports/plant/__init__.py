"""How exact, robust and fast the plant is: measured in one run, beside peers on the same equations."""
