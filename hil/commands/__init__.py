"""Commands of ``hil`` beside those in ``hil.cli``, and what all of them share."""
