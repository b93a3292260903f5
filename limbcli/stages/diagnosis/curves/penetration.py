from limbcli.stages.diagnosis.mesh_error.penetration import Penetration as Penetration  # until users name it
