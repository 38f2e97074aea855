"""Results of finished runs: their folders read, pooled over seeds, compared, drawn."""
