"""From markers at the joints to the joints' angles."""
