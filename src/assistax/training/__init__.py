"""From a configuration to a trained team: presets, seeds, one run, one sweep, their files."""
