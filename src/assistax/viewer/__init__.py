"""Watching an episode: live in the browser or in MuJoCo's window, or as a page that plays without a server."""
