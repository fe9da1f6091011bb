"""``hil reproduce``: section IV of Nguyen Minh et al. 2023, through the wire and the FMU, compared with the paper."""
