"""Is the installation sound, and how fast is it here?"""
