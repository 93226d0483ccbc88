"""The electro-hydrostatic actuator: its reduced model, and the tracker that runs the EKF or the SVSF on it.

``model`` has the equations, ``layout`` the noise that is assumed and the places in a tracker's memory and
records; ``tracker`` is the compiled loop over samples and its door.
"""
