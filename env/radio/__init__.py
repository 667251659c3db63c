"""Path loss, fading, the RIS response, codebooks and the radio map."""
