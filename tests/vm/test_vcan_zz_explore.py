import time, sys, subprocess, pytest
from tests.vm.vcan_robot import *
pytestmark = pytest.mark.vcan
def pr(*a): sys.stderr.write(" ".join(map(str,a))+"\n"); sys.stderr.flush()
def phase(robot, name, twist, secs, source="teleop"):
    last=None; t0=time.monotonic(); n=0
    while time.monotonic()-t0<secs:
        if twist: robot.client.send_twist(*twist, source=source)
        time.sleep(0.02)
        s=robot.client.state()
        k=(s.status.mode.value,s.status.reason,s.status.standing)
        if k!=last: pr(f"{name} +{time.monotonic()-t0:.2f}", k, s.status.faults, "tx",s.status.tx_dropped, s.status.overruns, robot.client.truth()); last=k
    for e in robot.client.events(): pr("   EV", e.level.value,e.code,e.text)
    s=robot.client.state(); pr(name,"end",s.status.mode, s.status.reason,"twist",s.status.twist,"overruns",s.status.overruns,"tx",s.status.tx_dropped, robot.client.truth())
@pytest.mark.parametrize("name",["moby","omni4"])
def test_explore(name,tmp_path,free_port,capfd):
  with capfd.disabled():
    fresh_vcan0()
    t=time.monotonic()
    with VcanRobot(name,tmp_path,free_port) as r:
        pr("up after",time.monotonic()-t)
        go=(0.3,0,0)
        def arm():
            phase(r,"zero",(0,0,0),1.0); 
            if r.client.state().status.mode.value!="drive":
                pr("RESET",r.client.reset()); phase(r,"zero2",(0,0,0),1.0)
            phase(r,"drive",go,0.8)
        for name,on,off in [("down","ip link set vcan0 down","ip link set vcan0 up"),("del","ip link del vcan0","ip link add dev vcan0 type vcan; ip link set vcan0 up"),
            ("enobufs","tc qdisc replace dev vcan0 root pfifo limit 0","tc qdisc del dev vcan0 root"),
            ("passive","cansend vcan0 20000004#0030000000000000","cansend vcan0 20000004#0040000000000000"),
            ("busoff","cansend vcan0 20000040#0000000000000000","cansend vcan0 20000100#0000000000000000")]:
            arm(); pr("=====",name)
            shell(on); phase(r,name+" on",go,2.5); shell(off); phase(r,name+" off",go,1.2)
        arm(); pr("===== sim killed"); r.motors.kill(); r.motors.wait(); phase(r,"killed",go,1.5); r.start_motors(); phase(r,"restarted",go,6)
        arm(); pr("==== cangen"); c=subprocess.Popen(["cangen","vcan0","-g","0"]); phase(r,"cangen",go,3); c.terminate(); c.wait(); phase(r,"after",go,1)
        arm()
        t=time.monotonic(); end(r.service); pr("end took",time.monotonic()-t)
        pr(r.log.read_text()[-3000:])
