"""Result files: result.json, residuals, truth and the state of an interrupted run."""
