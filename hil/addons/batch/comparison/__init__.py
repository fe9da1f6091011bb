"""``hil compare``: laws under the same conditions and seed, at their best and at their worst, or in random cases."""
