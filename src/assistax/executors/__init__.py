"""Lists of independent jobs, on however many processes and machines: jobs.py, claims.py, drive.py, and the executors."""
