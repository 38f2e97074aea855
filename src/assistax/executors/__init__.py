"""Lists of independent jobs, done by however many processes on however many machines."""
