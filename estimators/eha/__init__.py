"""The electro-hydrostatic actuator: its reduced model, and the tracker that runs the EKF or the SVSF on it.

``model`` has the equations, ``noise`` what is assumed of sensors and drifts, ``layout`` the places in a
tracker's memory and records; ``loop`` is the compiled loop over samples, ``tracker`` its door.
"""
