"""What finished runs have come to: their folders read, pooled over seeds, compared, drawn."""
