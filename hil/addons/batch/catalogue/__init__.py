"""``hil catalogue``: every fault alone and in pairs, over every kind of link, each run judged for safety."""
