"""Who may be in a fleet, and as whom: one certificate a node, by the fleet's own authority.

FLEET/fleet.json            who there is, and what each may do
FLEET/ca/ca-key.pem         makes certificates; stays where fleets are kept, best off every network
FLEET/ca/ca.pem             tells them from others'
FLEET/nodes/NAME/           for that node alone: ca.pem, cert.pem, key.pem; where it listens, fleet.json
"""
