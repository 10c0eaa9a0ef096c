"""Which poses to measure: candidates, their information under the noise, and a choice of them."""
