"""Harmful files that the fuzzer found, all rejected now; compressed by zlib, in base 85."""

from __future__ import annotations

__all__ = ["FOUND"]

FOUND: tuple[tuple[str, str, str], ...] = (
    (
        "v.npy",
        "a header of 4 GB was asked for",
        "c-oun7wQ`j$;9v<2&&anQj3#|)U6cMZPF~%brjUo@{3A}67%Boi&9cS;vq$)sX7Xip?XRf7#N7v0|0O-A~O",
    ),
    (
        "v.npz",
        "the unit was lost with the name of its member",
        "c-jl_W@gc4U|`??Vnv2G0=29DLjeba2t!I@Nupj}K_w%D0K*Rk2si?zXTK4DB`t9BM8L6tweu!L&52o(w{$_?<jf`O7B84LEj}b@$_(-"
        "O@lz&o36*=F(ez{O5>HnVTf+2H>X;RmnibcwSyo(Ixt=iUm9g2e1+q!9rLyU=IkR!IRkNA1#kUExWwfcZ`Lr>$6}4Hlg|*4Go#fdpA!f8DA>#ao-bDS"
        "wf^C<1rc2}**(6k)`_T7L`>;G)nwy@RqZ_ANrJJc+tedb~wwt<}|1pMR1;;Fog&dPPmUK+(nA<VFV|B+edx|Be8!#~hp!k0OWR<fp-"
        "*W?fUtExwoSByn3xF9=kNe{ffV72#0|4xI5e7XrgNg+Hh4BuVV(e&c;hr=-"
        "66O{zpj+~bGSf5j(47)MO{WADHe66+SJ*O_8O<%*K1vJ0+`<b=6`4h;$t9WjaOa$$o^!a4fgO~>40O<sg!2vJ0@KigW{TOKlQ8FS0-"
        "aNumswH_b4mx)2_ATzBAi7ql|sUWaa{}>8=C+d&<Tu8y3D9K1(XwhKt*7nfe}Q)@(sE!PznPjA5i>pqv-"
        "kvB$3h^x<*iP2!LwjLeba-v=EUv(Di|$4x|qhL%b;Z#F!XRBNAOJD40Q^2ntb76s=2vS`A@=9^lQ&1`=ikLP?-oG?+m=08GnDbN",
    ),
    (
        "v.png",
        "a wrong checksum: other samples",
        "c-"
        "rd>@N?(olHy`uVBq!ia0vp^>_E)M!2~25a)cFul%}VPV@SoE<do;aM_GC{i>*7Lv?@EP*Y(SRkHrx#&36_HZS1hC{>>UJ!r<c|xXoK%J_@Ld!PC{xWt"
        "~$(69BVJ9EA",
    ),
    (
        "v.png",
        "134 rows that are not there: zeros",
        "c-rd>@N?(olHy`uVBq!ia0vp^>_FTj03;ZW-ZKaXQsSO2jv*Cul2a1g+jMx^Qi>%d{~0J1GNv47y8h<R#CniYPgg&ebxsLQ0KO#^V*",
    ),
    (
        "v.vti",
        "a letter that is none of base64: zeros",
        "c-"
        "n1~U2mH(6o&8fD~^1>gwmikQb@&DTAHvfByFYLR8Hc#Zoy=ZwS=qv^_>Hh_F^CmkKgxv7{m1DTo&+0n4_w+&n|`zyO|B9Pn*SD6#{I15I##wE=9~OXP"
        "-`Ic)?&>Tk%qvy)ZsoDr*ao=)K~a!K>gn`_jfgrrKV*Y&HOx_POBswL<^d3T-"
        "hRjKP6Ryj%tkMoC58IPlHIS%<;;z;{YZs_TI>yz;;udJJM^#Ll*@V=SHhy{-"
        "2{iJgG|l_8l7mD09pXuablH%FiCg+3}<cMkNB92mpv?uE>YiqneVJ1@njAAVJ)<XC2_G&jgO*HUD(l&cTmXP=E-"
        "r_T*=9kj<d!QnOx{{~UDS`pL4Il`e@$sov+lyv0qn)r?Q{(u}cx_w8^a^!eTJSP3YBX0cRV@CO695$;Hrg}$?=5doBdFdd>KZz&Ad4il+<Zw;=O!2oN"
        "u_oS9{M}RB^mB>=NqUN$Mk(oU7%$Ta>d}Vug8cUf()XlS=$DH;Zu&?4H`QNENUuq^=$Ffa^a<%F>L){g8sCv#qhDrT+^qNH`yZP%>UXQ#;ZeWE-"
        "9#jc;tP(xGP>!DX&?KK6@Q6Q_fO0Q{{TFI?W+",
    ),
    (
        "v.vti",
        "too little base64: memory of the process",
        "c-"
        "n1IO>e?5488L!EZ^6LLdOoIXc|L8`xNZsh)nTHq%=ioG|_**gqFf#ilW5!v){8logGUJziew&8HvM4;4B+VzdoK8N;A0Tz!H}w6+9<LctMJ2h_G!OZz"
        "{WEEAd%5r}@$B6d8m)llN}g{LiIvqXe@7z_hOg-"
        "}}nrkB*J=<zNf~M*b!UZ&np5s1b0Jc&|WMA1GI*2)rqXXp%w_r3iCnId`pepBqm9wtVl3bB6zDLO1{_W!y>7IwwuGmbhb6E7x=gj|t&>YpLl5vd|TUj"
        "^LF_zTn}fvL$(%tukc2y&_ZaOK4?sHs~mEoQS?Qz}>0Z?O4h)UEK3^8slDM=XhYPugv(`_UO=a`|Zc=ml}6l%?5wF`Hy)",
    ),
    (
        "v.vti",
        "the process was aborted",
        "c-oy)U2~f-"
        "5PbKqxY28;1_S<@G0r&PG;Y&4i4!O8i${h7s|AS&)iM9R5~R49@l(YhM$6va?n#<l9P<ngC`%@|PkLROTueKY_2aiImLaIBK%Xpfnqo*5B`2oc?Ge~j"
        "3b#VWD1CCnl*(|<V@5fFJyMNsoA{>%SFS@K5_uu9EQO{Y)UTT#o=F<CD4BKuCT%r%-V2@asE{jN5InHK)vwO9lq_XNuMM9ajoJiO1&tU_jj}%2-C-"
        "Y`Zl6HNBu1(+r(@02e(QR=;vK^X;cTJ*8%<u5Sun0@FRO@VRF*!8k(W$W<S$3F3}GfEt>DzJ5rJEp<B1Q6kU7=*Xi*@KF(&Xpd5YgnAKbG_oB#Ca6Q_"
        "U9i%60ZjpK9CR%^m)U9?buS@r?2J|a5C^t9ejtKHCgIeV91cLjMQ;(FJ1w8VkebY(lcpXm{p$?17RZ{!ZVp;_IfX7>G2U|)y(r)W`$<1!q7d0ap2HhK"
        "0IyMwErUzb!+c2LrtS7Uw1mdWpN@)idB`R2OXsM}BltM%o}OTI26_w|x3K0R}K@7G%YRj2QP^?nhioj;5Z+>`",
    ),
    (
        "v.h5",
        "chunks of too few bytes: memory of the process",
        "c-"
        "rgqaB<`1lHy_j0S*oZ76t(ZWbhvfW{9KmVe$!3nh{EOK<O1sFmXn(oCH){5NbZUx{x4OSCH!eXaHu<16Byl!7vI&BJgl^3;@v)P(Cb`o?t>%mxz`gJt"
        "(vnSNio}hVV03iA%p09HZ%XH2q?x-"
        "wsw(b;+qYImJ{=zrlX~E}#?)OLq#)X!!#z9ghNB<p2jH%ot&O3kb~&5ny3J&EK3*8kaaTFa<C|(*YAwieQD>!^F%4Hkcb|4<lR+h~@y7NW~eYX=ypBa"
        "B)VccuHzoPGU(alD!HL`<Pf7IAKOWoW+S`EYNm{{Rc#$>4AX(Ev4d5R~qc2X@ndAsy7&c(ScrXL=mZ9LkvQrt7pNXz6q*6jscMv@PRux)Z;SWN*tAsZ"
        "aycG_Kt#4FbYP&C>RB!U=)mkQ7{TH0S|NpmJ!%b6Jd~GNX<#jP0cHbFV3t=jW5k*5LB>-"
        "_R$;|Ot=|L{=@qJjEvBJC<6)&1r8AEfjxx2U|$iJ{9Jfy;5DNy8_GZPcKV&t(O94TcBW1C!>+HlzsXtFzI@jF{QbUvKhGc2R$99xGa>K!D`A<bGbYA|"
        "-M(a-`K;;b>uv8WYhFF-{eAvkU7`Y$fsr5^!}3omQ-"
        "CHv6Phw1{IcoBvQIo5{oZFa*JZtVG2g8G<SSomei{4nujd|z%h&%&dn6(-J@~5OwxTZ|_`7{i>aEJjct6`J{o|@$>u>Vb)la`Io-QxZ$>4LQ1=u@RQ{"
        "Gb%_xoS}RQCw4K<E2st{t`3FjBN#zh&9Z>_<I6PhZQsS^MHi>+A3H_Er9WtIxfC!jh(4^H%n54o`5YiOTaV4SwG8^7FKHH}|}L(E0iLJG;cRG)0bx$j"
        "F-"
        "<j10HmsTu%H|I<COIo>DC_4bKN2k+{es9CPwuxQ`f@>6eIwas(xmw!3)G@3tt&%ZB|8|V6mxJ916aOmDya}_Ji%?tLd+nWAqO{?~`{M*$}zAT;19}yA"
        "3$z*0`R_4UOkfWp$0RTLZFPi",
    ),
    (
        "v.nc",
        "the process was aborted",
        "c-rk*F=$g^5WagaX<yUSrl@UNiv|P<f>5D@;E=@h#RSu|G(`o$7@HIVNm@*bZ3o3cs3159B7%e9(9KP{2pt>*m*VEu%}&xq=pe-"
        "Zy?6g>{vQ&fEkg1CI$ZwC-Tikj-@W1MljKCA&o|-&3x)w62tYF$1UN0733tdM*)_838uz39U6A|(R9}vpoiR--x*>tzGv;xu*qy@vf}|Onw(Lzhhsl1"
        "@#JD=yRkAB&mnEK#b$BmAuakrPe95u8<IpLN=m}o3t^EPJRKNhxni%Z`!}e>MW*0VSV{}~hiW4~SLzMdIgA**eHkU6KbMyJR`ocYX&q5LAwGf5zUKnr"
        "a;{1eYfbQR=Teg7jnd2V|innJoQxnLhGUy!A+dsb$+09e!<M{hwZMc0L-~Y|Qqs`}TI0h$S6wbnVxX3safdov#EZl;-P=ZCc4-"
        "eomJcZ}*3f{mvyo2}f0Y1WK_yS*H8@|DJ_yIo|KYTcVK|F)!@B)tGWxRqZoW>h?8;e-R8m{6aT*GJh0$<}>+~-"
        "ZN&6|9okXx9auN7%=I^)f5#LxGD)$y~8T%uGiU(c79iu5~4{6=?fnZI3jA4}Czy~fVNh;~N6%`t?0%Wih<f4&-@N@Ei-P}=irWHrfFD&l_1{_Ylj&U-"
        "`RVUOhJJod@)(jFxH)w^9mK|w)5K|w)5K|w)5;demr3;G<_t=36U+Lq#V2-"
        "=~obdJ_K+}4m25ftkANlCPH41@i})3I!posSC|2EasW(#&L2Q<+>g9!r}nFHCt}J1-NPG=cK8raZ1=^0{`Xi=^9u(eCj?DLeYNdW+Qy*IP7u-"
        "bMPppXCIb=1Qlsv#cJ~8lp;wqE4#2zuSIYLpt|JXP<p`o_ni$e%NsPs<YS`Ghxn{nYc-"
        "P4Qftbg?v5lid}8M`!AF##cHjzQ0?St)9j9>6cYNCbtzdlMK-0VGmG<boyv1y9={xcrv47b<3^+LurnU7NIc%4E)491$J-"
        "Id?vmY$90s2~N0>L*A#eEq9lQsB|BX5k;eY!6Tb6jUH~J^M*@}q#*>QPv82srz!u;X7_AeJ^+S>",
    ),
    (
        "v.tif",
        "a strip that does not unpack: zeros",
        "c-pOzd6XAY6vyv=pR^68dhLp26rvLCgQh`*NJSeVLR6xXMx~H;+aR(ei9#hyR7w$ptjQ8Zi$qarvAmh{qx|9c$9?B>-uHdqz3-"
        "fNzWMn%5CEVw019AIWfGXt$pu0#(d84I(K-ykGP;<o)X!<3lE~iAuaJ316BUzR+%qFl8MVZpov4!0^AmOVn-zkR%1ei$#Hh3y|9$%x(V;A4Lsh5^InV"
        "%_Kuc%??Vtm6f!GszLthvOLt!M0fk{vZQ(-"
        "#Hf_V@Zz!F#iD`6F^f%UKjw!_}^xl)*gu@ct6I#?eYVpGh;d~A;$u`Bk%J{bGqAS}SqI1cZ|2k|j{3ZKIlaUm|lScD(p=eQO(;a2<=|3ITMbO=?US`?"
        "3@W9bBHL8sCgbS`zK9&|ZfL)X(y6i3h<G?DJ3hv^A=hUU^M^g6vo@6)FgzoPHx2l|Ef5b*(Ao-1;7KAh|E@f=U$*4&oQ;`8|;zJ#yj>-a_<#-"
        "n&F$Gi9eew1hMvpk<)<2U#n{*YJmH@uPKPrQ?VXO+@&uvC^qrLG(!jitGqBL7eJh4kOqPosU=&!m0X&!K;2Ut9~5mzRc$_}{WGu6VkfBb}tXTqak`02"
        "v~~<#w4M_sT;Or^(YYM_!i2@}|5epU9W;t!$Q`Ww%7spyjlJR@1}uC_PS3)K;3OXX<$xFVu_m3cXfu(3|yEy;CRa{rZSLsk1e{ps(sueOo`!&-"
        "82Epg-yk{Y}LVw0Mw3t7%8r(bmYC*~xaAooyFbH@np0Ro34I+bwpRjkkMjial;K?Rk627Fk?w@7l-"
        "qg{`yiZJX^faQCvF?NvS2_8f2EO}wSI@pj(9yLeCU?R|Zq$Duyb$M_^K^r=4GXZbu|;7fdkuk^Ue*Z6wh;@f?%b0`(ELZwh6)Cu)NY#5q`+>jsIhmN6"
        "Z=oR{eeqm532&2QF&Tp+x",
    ),
    (
        "v.tif",
        "memory for absurd pages",
        "c-r&y)MDUZU|`^3U|?inU<9&w85jf@p=_Wi0}~@Nm@NRr%usf~VUPfX4Z?yz^~^we9uSK%BE-d@=CA^>I8Yp<W)%=iF|vZiHvq9Tl)VFpHIVdv0}=;-"
        "v^9|43B=V5bquy}Ss2#Xs{dD^X(}^=Qirs1!PB!W@($mBygQ}2Zq6eN!mq}Q@%g^k>asW2*M={*i>)eoael6O`o5UTq9@0D#ntU%DhduTF#dVDS^fN6"
        "tHN7LG=-OWPtyvVrJ^ac#Jx|-Flvd0;3DTXE<q_34GyT)Yk^jK$S4<B%W`b>Q}(FZb-+J+?bFvLO-r655$BdXVYJ<PCD8frmdn1zd$(NjRIc4}(N)-"
        "X%LPZ~+WUJ-A8+%GHhXh@UG(O-wN|ECmzTIUe>)RtoOXJOs&m<y2*aeqEv(ExlKZWnRV4QsA7g^pZnBV(VJh<+=Ecmbm^U)-"
        "VBXJsjQK3{73SN_kC<OFe_;O3{EwNHg@;9$MT$j{MT143#f-"
        "(4#f1eWwi$?tZ8k>C*zRE>9NROP5V1Xv2@%`Nm{4OI1U3N0^njX{0dXBe1(w)mKnZl!f~(IMo@Od%HN|a^Tf_ePU=@OrvHP^?>x;9VO4{-"
        "dKQ}VJ+iU&(?XAtp`}6i%eSLXpv2*>qJ(i!Jo|>#|pLeEW<D(-T{L*?h5epg^K3(a&tmZq@Aa+wo=Oq=-"
        "i3+wwS2`{#xpoT3GD2;y1=@Z>O0i+D<XM@QUk%Nk9<P;|e!MV7?s#FP%<-"
        "p%AkOOTqO63{+5`3<m(%^{S(iTA;u);wGhHWik%?!Jibuc9|9?qaJOY(m+Id8kOgsVv5V3ue{Q>)P_IK=G+5fOJb8vA8a!7E<bEt9Xa+q*fb2xE$as+"
        "UMbHs6^a^!Fnb5wCOa&&M203Z+>Is",
    ),
    (
        "v.mha",
        "packed samples read as they are",
        "c-mc%JxBvV5QX1hA#5R72qJ<9f`t%COoD=l<QId+ljOich-~6UR_-"
        "V4t(aH{7NUh<Ay^0&f`y%(o!Hpf+1c6I+1UxY7ovzP%QD}4!^~T|zAYNs>9mA3Z<Rd0CD=+{dZDS3EGvDkI(e?SDIK*V{*Y`(3tMdpRjy`@TI6mhST6"
        "8dN`#@<>^1!(Rk;_<NhA}@QQQxkf%3{+E7^{y74M$km)Xr`D0C#nt=M$jO2%1E_*y8tSqU`PGVqPqb+e4mb>PVccWot&=|`<(O03`t&!B3HH>AH6wM?"
        "bWok?5MQ)y=6_V!9!DU-VA?)^!*;A~VE?TYimqZ~!)M%uES%Pg~YjoLW+>c;?vFp6<ZB7s>fpolUYtfLNz7Iv|ZL!96Y7r4R=ZgGcuJmLw@c)=^)@Qx"
        "3BqK_C2(lCwD1jQ&tbCjhLt<oCRNRUe*?a=`p(<z<PC0*0Q(#ZHXCq9A8",
    ),
    (
        "v.mha",
        "a matrix of 1e308: never an end",
        "c-"
        "r$%%1TWx38^edRj^g?%uP&B<??gM%q<4;jJcdL^Ad|HT@p(Yf!vUy(o`f7r^=F4|Du%CBHv&qpsZVBPH`%ibAE0?QEG8<Y6?^nL^z}<F|Rl+zbMx?v7"
        "{)o0w`{%U;u=Msm2BtP&Saq<)4;ToLT~sHc-$tGEgu!;BrpQD@iT#PYcQ~Ni50C&jU(=RdYG!C6?spW+o@*_!ngY6~SbK96h;Qb5e7GLcs-"
        "z$(ecSAT4^PKx}TRV5Dct1@vBUW);Z4rV1uNUqV&;mF6aaY;w*>%*#v7frJ254jMkbt|9TE&K{0IFmaGC-"
        "7<4Paz6gfjy_!Me4;YST80+(ZoVPWNtp%Zb*(*<XDwW@e%sz7r!U=n@ciA^Kg?W$67p)gCe}`#0pW2#o2nW+`lroZvU=0b1IN!@z4Q3h#~=UMctxa@G"
        "!4w{Tz!J05;OA4YFoM|&0Mg2-PS#aPhGrm|JmCwznM4%#N||VjIA6!{KH~XvWqGk+WV%?S-"
        "fiFj{V2ZUb+3~<%jS8Sb2n{6gBkCY+byAA`{Z{N^6?CCeE0@Z0(lahfZF&e(&iU00@7<QU",
    ),
    (
        "v.nrrd",
        "a spacing of 0.5x9",
        "c-mEtEl31G7>0vEm>?JggW$k{c(OlpKa08sK}9fl$RQX6Vcq$5@59}hVP=lg3xYu~2nN9*7zBgOX0zFBHk-"
        "|6vl$$JE||WDm*@R>TkZA=W2{LkbXk_F01LF`GMZrlG?ThaEHw&J%rH$XN<kAFJG*18io?(Xl!1|5or05d2n5(rXwAdlZqTu1LF|Eon0AH1TmYwOC(("
        "ps2`-Q#rVV0Lk~*V+%=$_i3mT>NO;`N@G1vza(}*?)F6F2p{odp9X%<8t^H|l9$AZ~tfcx`aJ&3Ag4+VD~mt}(D{~;h!$x-"
        "An)k*K~xzw1W8#Y~Io?mBPgH;I`9vPdc%+%%<SJyYUcTx2Yk5A7puW#?}A0D5cUtZtdKR$=Z==kK6-&|N)+t}KH!t{?$&MvNQz5s&WdiD",
    ),
    (
        "v.dcm",
        "four frames of which one was read",
        "c-qC0KS*0q6vn^v65B`7G^uIG5a^?ok_tZVi!UV5K}cdTVESzSkb*%(=upTYI4BN^gWw=Y6*?3g1P2Gf&CSiNTQ|3C-MYC++wWdqL+fI;-"
        "pAv7_nhDT&UyC%|94fY<(kFVnvJ5%Xh9H^bmS6?u~p5$b8~LdSFWd&D!O^sbA7%#>ye0%u?;in`rOC4Pu@B6hke4@gIg9hQun&sNdMz*V-"
        "e+sg>uuu2rE%tfrD7zH;=5Ix}m=$izw+~)PlD`d8QuJrgIMHQDxP4vU<{no<EC(QA1P^t>RSDSC&zasUk*k)nDy5-htBqKYyY3p3y<-lg?$rT+-"
        "wUsBi+Wqs+so`x<U6<TRhg9JwesKkJIxhH?w}j^YQ^mFaaF^3RR$sPRaJxtPi2c#gNw$+3&hj{QZZLo(hcZA0pggSzGib}i7gw;4y!2G&@6$UpRyH}e"
        "AH@KD4Q-k^pi=COp2SjH+gu#H_D;0um$f-{`s0+;xTZ@5Aa-|++2xZ(Xjl7yt?nY@$<@#VFYq$+dLmIe7BU0IQJ*^(XElh1M}$MPFDG=_5",
    ),
    (
        "v.zarr.zip",
        "the name of a chunk: fill values",
        "c-"
        "jl_W@Zs#fB;1XhwticjEoEnAj}RF(W^=<DoU)Z=2B2lD$YnONL8{@hz4>L6pVGilnI0~1(LBKrc!c7X<l|QT$zy$GKEl<Qc?*vOvx_ONC_;GmYI_iUz"
        "V6t3KBK|3*{H3q!xh`xxtl`q!xh;&nwNzftZt-"
        "o0?agnV%P5oLZ1rlvt7v)}RN`ker`eP?TC+3>K^gJ3%Qk1*D)VCo@S2;wYt@)UwnZpr9d;TMO0)@^yS#eo<~>2~gaKt2O{7l$`f3Tg(JxfiN_bN=k}~"
        "tI?EkvdnvC2xNgUD-av#0bvDWazgryGYgJx=xyvz6l+#I9LE;e*2*Ks<1UdR5oU11curbCTEzJW#|k(ZX6)gpMm1BNU*)s`$Sk;-"
        "hF~*4r0zHwaNt9`V#`BDXG>*cXOqLlZB}l2Z7OZ$JZpQJcxLj%OIAs!GF%Gb{EliQPw|a*6(CCmYNR35nN!je5=xkoOclPdB*iN5F(e5q@UbUlEA%BN"
        "0KMGJRD)_vP~`CqsK!8C=98L`@P^@$jKVwiM@b6v*p7rc*ob#XH&$>mGc%-rXSE3MW@Hj!#+?RXpn;JAks{GGp+^ZqlNuvDg3vXgM-"
        "W1jFC#R%(6yk4KSIkwMrdrHYe5fRgqAOi(9lNLf*zI#E!IE}8tRyWw6L;)gxG-43}{Xh$ma|IOSQRi",
    ),
    (
        "v.tif",
        "ImageJ's slices at other places than their directories say",
        "c-r&y)MDUZU|`^7U|?inU<9&QftV4>W&vU*MrJTu0En5PY!GHcV)HRFF?a*%RX{8V)f)gLM3K~pA(<%-WorPj6eBB`Z2}~up==u<p@F3L1d#B|"
        "O-xVqvNhB*G)&~m1aXROjk$_*GLylKjLL%4qT-Uo<ZRoLqS92Z-29YO+w`Ku%Hrh2oK&vjg2d#^ymVV5JyR|Q3IP+;RWKSEuru&6h%(49C^Kj="
        "7&2He*fY2>_%ehrL^C8YWHJ;mlrz*Zv@-NCOlFwHu#jN|!+M5o40{=lFq~$%#Bh`00mE~KcMM+{{s2Roi&2nKf>EAPjZv4;gwdMOiP4iWfH9mg"
        "jxm)nhq0Kkim{QggR!4+8sl8XC5${2#h)OOdQ##njtLQGX-uebmdAt{Qq*zf0!He&5?g!%0G(JpV*",
    ),
    (
        "v.tif",
        "tiles before the file: zeros",
        "c-r&y)MDUZU|`^7U|?inU<9%ZfS3`=RsdoqMrJS@q>35J24OZNwkQ%?ijfseuL5FeD0>qSYapp{f|@S?#Lh@;7a*GrNbdq-SD<<j`w|d8U}J#m"
        "h2aMv3}ifD0%B$$W&vVWup|O9u=9z^C~Fy7*t_|LL?>kygvX`k6jwEN^iP|+Wc8+<2bQnfy65nzi#P5+d;8@#6Q{uUf2=&hQi>Y-X0|TgL6HgW"
        "exWhRS%nq#ZM{=wFIu@_`n;uUHt#xk;{3I{PhNle$?*K$*FVf$f)es-x+d06o&n}|u0Fw0i5dB2wJqI~W-e&&n>uIls*OALA3J;H_M?{{uHSq5"
        "=JPK`4t_CN6>TF+2X#GD8)vV;i1@VJlIo_;3FURIJ(FiGT(N%J-Xo_k-F$HT+|@geUw!=XpN&^UT1nGDTuxQT*viqvKP)ySyQs1uJ+HK;xohH#"
        "`ODUB*?s8bh3)%}p1FMM;fwd*{<3fjNh(m=yrCAJgFSv|9iF4<e>DA%<n&Mddaa2aQLlBe6I-vbf$OqK?1*}86_CxqfLX5{0E!;~I_dx?5OV=B"
        "HxTon*K05^n!iW$_h|h#n*K-A|Hw@L0In<$K>",
    ),
    (
        "v.tif",
        "more places than lengths",
        "c-r&y)MDUZU|`^7U|?inU<9%ZfS3`=RsdoqMrJS@q>35J24OZNwkQ%?ijfseuL5FeD0>qSYapp{f|@S?#Lh@;7a$wN*#%^~0@bqt=}SQTfQ<pJ"
        "7lt2zFp%+p35c127^w9DD_9Z%8QA$mWt6oHE$rQVL!y&13&P`4bBe1PJNl>1U9x)9&I8NWZQXPD)WsY3pS}I^n~784`#)A5VJSroeKT7Z@1V#8"
        "cfZh><gCJq`nKLFvlp%0Fn!+AHJf)GJaPWo-6yX<{bYFl?&}|BE<p)-HC+>HC(i(LJ6E6JsKku?vf7sJNi!F;_f4I%c-6)o`;VQya{JNC57+NK"
        "ee?MjBL}~jtctdgrGvVjsg1K&U_^XcZb@}h=Y;aQ)}G0;7Oq&oZSRrOmu@~de(vg>$FDyA_|L{GBCVupATFn>V{GN<;U5;8l3i5Uke*js)7&+2"
        "#{6Y#x9mQ2^1}9gN6%co_3*{}Z+}_1g(MZIZQf7|&%qu)v<}bF^go*ZM{@e7e!bSjj;PnV*om*#Ky}$9c0|3l3dm+)z^vB}0L2dg9d&>ch`E56"
        "8;E((>opjlM)(zH<QJ8UX7JGrK3c(zrvK6OKeWOV089lCv;",
    ),
    (
        "v.tif",
        "a tile at 0: zeros",
        "c-r&y)MDUZU|`^7U|?inU<9%ZfS3`=RsdoqMrJS@q>35J24OZNwkQ%?ijfseuL5FeD0>qSYapp{f|@S?#Lh@;7a*GrNbdq-SD<<j`w|d8U}J#m"
        "h2aMv3}ifD0%B$$W&vVWup|O9u=9z^C~Fy7*t_|LL?>kygvX`k6jwEN^iP|+Wc8+<2bQnfy65nzi#P5+d;8@#6Q{uUf2=&hQi>Y-X0|TgL6HgW"
        "exWhRS%nq#ZM{=wFIu@_`n;uUHt#xk;{3I{PhNle$?*K$*FVf$f)es-x+d06o&n}|u0Fw0i5dB2wJqI~W-e&&n>uIls*OALA3J;H_M?{{uHSq5"
        "=JPK`4t_CN6>TF+2X#GD8)vV;i1@VJlIo_;3FURIJ(FiGT(N%J-Xo_k-F$HT+|@geUw!=XpN&^UT1nGDTuxQT*viqvKP)ySyQs1uJ+HK;xohH#"
        "`ODUB*?s8bh3)%}p1FMM;fwd*{<3fjNh(m=yrCAJgFSv|9iF4<e>DA%<n&Mddaa2aQLlBelUA=yVn@_#tAK0<2F!X51P%Zlb$}Cyxqz4(h<VWK"
        "H5eGp-=q0^w0;{+|D)-DWTt-r({>Md",
    ),
    (
        "v.tif",
        "a slice of three was left out",
        "c-r&y)MDUZU|`^7U|?inU<9&QftV4>W&vU*MrJTu0En5PY!GHcV)HRFF?a*%RX{8V)f)gLM3K~pA(<%-WorPj6eBB`Z2}~up==u<p@F3L1d#B|"
        "O-xVqvNhB*G)&~m1aXROjk$_*GLwM}Bd(0fg4CkolEma}+mfQvRIc3olvLaFqQuJL<iwm*uHu5k<jlNuTO&PFE(Qt#6Vz2O8X2%N@G*!o$S^1~"
        "XfYTvSTNW#xH0%LgfK)iBr#+%6fl%C)G@R&^e{|jn8mP=VFkl_hHVUc8ICZVX1K&~li>lwbB1>eUm5-YLz;_GkWqqBo>7fam(hgLn$d~TlQDoX"
        "oH33ul`)60n6Zknk+FlZpK%)FT*f7gJQT$rEY2!OjI%f<M4Y8Dp~hJr6J|(J$CV4H=t^wy2>=q;J=X",
    ),
    (
        "v.bmp",
        "samples that begin within the palette: another shape",
        "c-k$B2UG|O07Y*@dnh6mNhA>}DuoDTl~q<HB`H!VR7NsV6dGnIp@b+aO--xJD2h^{VMNm?;^)6}?s?}8QwwKd{z(8d|C;DuM7pC`cm3a7AoCBw|9{;kAb_BtAVNYy2n!3-qel-!L_`o36-7);3~_OBBqSt|l$1nDN(yOdX=G$%kd>9CXV0F<$;lxvFHf&tz3AP$Hwp?0^y$-wzJ2?msHjN4e*I8VQbJi-85I>3`uFe8fB^$gRaIr+z=5c#sWE8KAk@{>89aC}Lxv1NLqmh1Lx-ZNsmZWm!_d;wV)*dkj2JNjZEbBvjvUFTQKJ|=dNevZI_T=^qNk_Fm@#7*J9aGk`uZ3c7+`2<$hdLiFfua2*w~oy<Hs{$!UQHxoQR2u36myGV)Eq4n3|e0Wy%z$PMylMY11$>GsE26oaxi2Gh@aKX3m_+tXZ>|J$p7578Y1qS~6$O9OllQ%e;B>m_L6$3l=QE%E}6BYikxRT*#tDi&(sPF-w*#Vd>JP*x1-$Yio<0ogK@TEyLd4p5@Dz<KW<cqoX4$R;<9u$%&OKSK{pK%&JwZaB*?L)zy{Nt5>sT%^KX?+*rGIE$;5_czAf=>FLS3b?fl*^1|EOoAvA0vth#qHg4RAkB<+&zP|YR`LSu!CN^*0%$6-%*t&Hq{{H@K+qR8>fB?2{-_DL5JJ`8%C%bm-A}}zJ-Me=a6cj{oa4>uJ>|yWTy@Z5>5E>fFzJ2@Hzkfdm4jdpXER68*a3Ufih>VQn;K73&I&_G`hYxe)$PtbnJ<73T$B2rG;`s67oH%iUlP6CS9UV<fObn+^ogy|imeZ$CbLPw$&YnF>TwEOS@$sBHcaDUF1kRs7&xH#YxOnj*iHV6^x^#)lmoJl)ltglJGFPr#;p)|^T)TFS>({Sy<HikAQc}2i^CqdOsidW)k)EDTMn(pinVDo|WpV4)EwZz-$;rtfH#e8Oygc&r^C>7O;P&m?+_`gyyLaz$@7_J`-@i{`VIf6DMLc-$fQJts^61ec9zTA}lP6Dj`t&Kq#l<{(_KfGxpHos&LTPC!FJ8Rh<;$0pm6cImUe2pmuXz3XH5C;VR905<=FJ<bs;a22uBN7@hPQ9u^6uR`-oJlOZEY=eb#>I&*VE9@z=sbX`1tW7pFVx!^XJbrHa7C*%NM?W{Yq0)6V1)dw6wI)+S*E6TN~}|?R@+8jql&T^W(=4e*XMPM@I*pot^yp^^4!Xf78{~MW>L2oT91*Ma5-Rb&YLA#U>=BWEJ4*>Ej<58i}EanT3^&Bcd`2D(YG~`~lutlq3",
    ),
    (
        "v.mha",
        "a digit that is none of ASCII: another origin",
        "c-l>mJ4gdT6h-gDLYP9Z5G({21Pj5Cm;?n8$rl5OE6IX|piGiU7}-yl9nqu^ECdTdM6eJn1PePmEA8y;?Ck99w6e2sHb#-*F}!>3D~?^?77gumJHlGBN*-?uwwjk-XtpHFN}sE4o@;JaN9~AzNw%wnt(rnrYFR^z+zkcG1ztyqFci(f(NF9s?uV^Fc@?ge+%tK?iud2&&+Jw!6gon2>*M~^O2%1E_*y8tRSh)PGVl%Tw^_#LI`CwJyS9?1^h>Lm5-YgEGf}O>8`5t_C$Y4d`Ls0`OEaTZlfB3_ZKaIipgr)f6r8Qvid}Vn^T?to-H4U#T&B#1F@iBnU<xxxU;)c0q5=mSs6(QIUF_o!$2h|Uu5g1}+~EO_c)~MY@QOFQ;}c&PB1WS$PLniEvy`Gm%2J8eXq`4mkV_%;=zxysgwE-buIU@(-FX2",
    ),
    (
        "v.dcm",
        "rows that are given twice: a row of three",
        "c-qC0KS*0q6vn^vlIlY=CjJQ-gg$I2vEbvr_(B2>1!GGCO<&9(6bwZK2O)#tpg1TFf`cF`I21Y*I&>&>bL-ZvTeoi6y18{Ljo-a}iERgU^FAKuyXXAwch0*HxZgEjDwZwA#>*&Lj1~mJoQ_;#F*ZsQ@Z79h@RjQ+r3!A&^<1B?&Uz#wWNgFCxIXuB?#KQ+(`83k>-)pPM)Fp78>xTXZLFYJvrw!%7-A)=D{v6&`R0((6V&vVWDq4ih;r~MD88r$<!4zZLyr=xzSHF*<Pt_bpn_->r;?tsj2fnj7{yhcI;|~$(*VCaXfH83NS^52M3@^hxjg1Mf!9>#VbpyMmkv42r%)jm1?Oj7QQJ^%KG#(IpsF&xK8F0H@f|fD$uJi)xh&7|7MfXh(b@E0WGW=%J<>L$?s)Cm>D=U+yR&PauI;@zf<<7PwSNAgao)@$Jb{M-p5i&msACzcSjPsou!{p6;S6u^4j=Fd7x;`X_=<1%jy8Va5<l^a_dg&BNy$TbEYsr4tjtMCDzYfAWldVLDLb++hjJ|E@>br<6}hp90{",
    ),
    (
        "v.dcm",
        "no word of how samples are encoded: a frame of four",
        "c-qC0F=!J}7{~wL<<vuBdaX6w5b&^}M4`vKct-*bLN1C2rWbPw6&j=zIutqx4oZiLgWw>D3J!vU;NT#*xw*Nyxw&O?b90l{|9hUH6@+ZQ<M{sX`+o2Lz55RMzpI-jJsn5aZR{{w5M&)4xx``|r8R^>GiXOD2$fRpAP&MH;;XYEi4qydFc*V}dzbsgzs~$&7g#&~n}vg_aR>hG?!Y_Z?qCB+ZXp@^IK_&sEAUa7`o?JJTj%;q8nEeJMlV~<l52ykcctk!=#jD-QMraIk()Q_7!^b-mrAC}GHQ;hWE9un{ImQ9cpG5<0F#@HKB`Z3u2$q0O|FG*UPd@p=3&%*4OcHX&3ovRvpI>Fbw%w!1+93j_(20@dc7<7bH?|y@u(KLipe#3j#C&n*+pmThe)p=-6`o9Qg@uyHJ;hEMc2uF7ugzckF^v0LuWXdC0sy=HZJ2TdKh9Io7l!}+{GRq;xV4%C0^q#-s1y4;uAjO3%+84Z}^TM_{sU7lzH*wtSrllL~=<wl1g9J<d$s7j@*%5c_5GEiM)_k@<x6EbQguB",
    ),
    (
        "v.dcm",
        "a blank for a slope: zeros",
        "c-p;_JBU+36o$Xt4a>N=G46`W3UU#I2<~|1KJpL|*K9DsjgdSoBnvB82o{2cU?Exv7J`UiAy^0&f`woqSO^w^g<v6A2o{QkU?Ert7J_*0BpXn$b%x9TpZ`2(m<xZbEBxoR+^V+&#lcFRmx=*~&fyGo<pRY)YXN5?TTR3|5vkhLI-BUHs`{ri!uW{TirPiB=l;qVMb4?`z{nGot@><Su8JhFD$Xf5spzMrMY&6D=FnzNTScn6IAES$bA}_!^>*mJ0b5yW6uh#p)jt}hI$G6eFQW&DBr1y&XEbkGZ5Qb{Vl-zVv;KK1!*-v)ekwyaspni28-#+|l1Md9Z7q?sRtpWs{hb=t{QcGYhMQg~>K<V@Mj7KFk0G<<NBxu+MzdzU)hdo7Hji=M*Oo9OVkV1|;bJ7iI8!QY%#@+{t*BaeQZ1oG;Inhe@;<iRIo7E+yPb9;3QO86@bj0nTgEmh6Q6G@>CmPn|0c4zOXMaj@NAQ^soZ+?ZZTtvn$hzt)arfD2EC7$i~e4wwf?MD*upk;u#;WvW)FL{W2`6H&q0=G&}4-UJx*|vRZel5Go0ld=efW|F6l3Gm1|t*2DiA)9qw|E`#j(wk9f=zp7M<6ywKPEir2j1E$?{G2R`wcFMQ=2-}%8$e(@V;cWwg",
    ),
    (
        "v.tif",
        "a strip in XZ that is cut short: other samples",
        "c-pO!4Rn`N9LImJ_g-nW(Y91t8OcaXQ>myX%U>&{QTz9zVp1(eQH@>}X(@RLX?l@FDq3Xn62lOqQH&V!Qfs}5mABP&|2u!0bI8eY&-tADeZJ4V&-1<KeglC7Z~#yj00q#i2oHv}cY%;=bfkyFdQ2{W3F{D1em(nnkte#A9~1tLdSbmFTC>8_2(`w~_cRXcb)J^B_O2p;LO)OS4_#|?A!Ppf_74uV&mIs2knN>wQwW-4jQ7U1-nJAW$3i`bh9(dX3D5>QKo>}XUXTU@VK|J0EEo@yVLHr)xsV4-U^%RY0$2}4Pz;-33v7jQ*b4{Xpg(jSjKYQ(hb^!bCSfN`#sK!g{x}3PFcZgOHs)Y1-i;69LVOHY;xqUH7UJ8Xd}Z-H=MT-V?g5yG)4Wkq7L+wbBdYv?eCqVzQSxuZkFgBD#hv&A{(`@wp$KX~jp-CRgA%DdT|gI6D)plv4Wn!6db*h=(d{&g?xXqi2t7eh({uDPy+QBNhx93ZMcZi)?WZatK8_<fmYecvd=|Imj@*qe=1chs9?VzsXugpr@>HI|b3(VZBdanaa_6Y>W6$6A0bamMc?GZGb^I#7#qaY+{5gNa6}*ps=4w`{D<?`LX)Z0LwX~D-rMp1v$~_V3B^&YpQ<LU(s~#LzP&o<1|N4JAn#}*+(cXNdqiKAkql5Ub9Sw~v?<ESrKKZAP)*eT>@1Am*q{~nlA=k-Ga;w}Xcgnr;kSvzR<tbS!FUjljj(i}W$d|HBc1xxFCa6y9YmA<(r|Ow{j-IDowTJfB%XN@mrK9u)ouE_n4!uk7*N62{eNyxFd3{CS)c16=ex_gR4*gz#(nBidc;mA)olxQ0Em%D4KlJqkbCPLhPB&+pb4_P+p}EBLH3Q6*<{C4`j5D{GX=bLm$ILT}%rdjeJZoMwubB;|#FUyZ%y(v&`O*Apz*<|+M%yMf-X_>Kwu9|rQ*1ArW(V5gcBIX+<LzWS-OjdiZJu3Xm)q60z^=DNw%Bg6KFiEtMT4r+jth@He`=s#+7`RjmfOAdfIVp0)p1d-p^I}ZTq~F4I=N&QaD7~VH^gPQOgGkLyBwG6pm<K_(TSTkHv7BE9tQiM9IO",
    ),
    (
        "v.tif",
        "the index of a strip in XZ is damaged",
        "c-pO!3wW1P9LImxbB?rZv@PA%jAW#xS*fKOHq%8IwSN~ClWH-FGD?eBNiHEx7s(|REi$>JVTjQvMhv;sS}JMEWi_4uo<Gg=sGfS9=lMS8`+nbZ-uHW+^GQ#S2L}KR0Z;(F3-iK|_bCu^oe%fokRP27U_w5q2)~~FJkKk#ULF<tj(SD=Jh*1DS5wrwywIyz$glKjQ*ZB50x0(LB>&L8&KE=WKX3omzK*&50|2tQd_^ijEJpckY`aYh5%MfFf=Fl%aS#vfp%Zk2ROk&EFaU<Z2*`nPFcGG}beIVRumBdpGAM#oPy(f}4mQ9>sDvG`8}|A`H^2yNf-%?{+hQVi!4yo#zSs{3V-{xP7|g{y%*Xri5uA%p;u3rTU%_I0FW9dluIKC_g|%sb1vuFUWfcKgUNXGKAIP`P3>>2WTKo(v@CV$Azu@oq7a9tq#?*{XqSGjWI?}mx0rjHGC_qE$TDqQYrU`T>-9r!3Y<irYq37u(dY#^;59ky6g1)8Aw4HvX8X`W1!#SE;@+o`<ci_(4gD>QZ`3fGySMw;ok#FHid^gVs-qx0!>a6gsBP)-*e}{*84lm@zyqs6^YJQhL;!pW2{+_FNC;!H^tkO_UkfstVZKRzfNmn^vAbQF6u*|YG1%SO0XZ5HZ6jM|^0Ym@#e;7^S!!z244=|d+2N)g5|7J8ea(tE`06XPijMg8AxbL2FsbtC!87|k!O>&#uA=Bgmc~s`h)AF3Gkk{lbd0#%3&*dB0B-^A~{uETF$7z(d(3ACaJxkBg?wY23^l}}jSLsN-LC5RudY9g-59wq2gg&c<`m(;E@92lRUcc1ubc_D1dvu?QIo9|tEyq{6q&f449tE$*n-fhdbE-MhoNbcLdFCQ>iRo{yG}oBXW~{l@Og2-^{brV#XPz=k&5Pz$^QKv2%1pWW+WcsKGP}$l2CTJ>Y@}^&<7~WbZ#&s;Hr4jF8FqjjW=Gf@JI+qDQ|xp*(-znTc9C6Xi|i^}VoU8h>$^-1R5h+C?>skcTT=4s*j>|(fY%Lnqph?%>~6c)vTNWXToV`LTD!I`(RFbtF5UHY{oG)e<+9xvm+SIezJt;k$)gh1uWj{TyzU1Bd>(}",
    ),
    (
        "v.jpg",
        "a table that is no segment of its own was passed over: other samples",
        "c-s4a<NpH&0WUXCHwH#V1_nkTWcYuZ!I^=Bjg6g+m4ls~os*M;i${c)hnt&6Qb?FzL{>^(PF6}rMnOeST|r4lSw=>qq^LAiQ^&y2#Kc5i-O|>=$VSfyWC|lECnpa#j|4BTgps0*q7lj9{{aR;4hA*`c4kH;1|~s9W<kdPM;PRR4rOHo0|qEyWMXDvWn<^y<l+V@*ebxl#K_Fd#KO$V%EAJatp&<6un4jWDH=Mm2?r*!D;0_uHBMZ}q3pErplHy=4=Tn<MNOPsV&W2#QmSg|8k$-rre@|AmR8O#u5Rugo?gKrp<&?>kx|JhscGpMnOVgprDf$6l~v6xt!?ccon4bAPnkMx`iz;g7A;<~blLJ1D_3pWyk+aQ?K^hvI&}ER(PPI?oIG{u@|COCuHU$M>*1rvPo6$|{^I4UkDoq&`TFhqkDtFl{$gZcW`qH({t^WGi;0DWnS~wXFGi+vkODy#Rz*WLA;&=W#6n>uqec!9r-=(U9^_Ou4*DRPRCJL`OvU7(>PL{*z&<0+V@+iF4DK<6ziu(`Ff#%pk6Dnxp5gqo$G+Vmvz;T(uD_9*GUI5@%t~=(Z53bc+=IWDRR2m?)U|a(NZ4$T|F;1kY2bS",
    ),
    (
        "v.png",
        "a way of packing that PNG does not have",
        "c-rd>@N?(olHy`uVBq!ia0vp^>_E&Wz@Wy!;AU#O8^{s&ba4!+n3J56;NGUg)0R>!Df!PpsgN<{IMekve<s!gl`wd^`njxgN@xNAgFzHb",
    ),
    ("v.png", "two headers", "c-rd>@N?(olHy`uVBq!ia0vp^>_E)M0VEi-Qg5%qCn4<V;uumfCpo2^LCpD&$zypAUIsH|rfZ=_tYRQ#p00i_>zopr06%aOU;"),
    (
        "v.dcm",
        "an element that ends behind its item, and frames elsewhere",
        "c-qC0KS*0q6vn^vlIlaOebE>)2n}s0QSfnJd?5jcLSn%OO`pvl6bvGQgOEXRP#pX-2o8d%;85sLaBvXZ+}zx{xpm9dt(%*){qFTOrCsdS`*@u1p7XokIqyE;|E{T^QneVHZ{uh)S`dU~9l69}Yz8Cn+`L=zmFp>`N^ZgRT%WJbdL&|GY{N{rKKBmy$-mD0Vh364d0=59^{Bgz^dIgv7E!5Ns5CNo%1T^UkikILw}70Ux~{(@hdAkeRKs^+Wx5tt-{dnndIYTcRF2_d<Pt_bp@L}TP)S!=Mm?j78O2o_J+8k8rvbkIKxd9IgVd4EjYPSm$rUlh3A~mv52NmDxNO8}K8+c2ad3Xt6}1iJ77H!K52`8C>muS`7~dh|k&1EyCYR?q-a;$SE;^gFev|2lbh@N%NZs*YT_4CS9(OI$wX^LYoCP*m>*XIB=FPms7(A5l8at?>fq5)p1*=%c7WQy}6MVoYoZ}K#xW)}W;}&1g!B>349qxJmeUgy0JeOB8F1}1kSpu1nSy_-}Y0H{y%C79op`6M`Ig_8Af`-=",
    ),
    (
        "v.dcm",
        "an item that ends within an element",
        "c-qC0F-Rjp6o&t|$>}2MZB7j-1j8vu6kKNGh6F4Gqhi3gnkWhek%KD^ECdV1La`7m1X004un;UP1UoxBJ3BkObar-j;`z_q8t!bgbC%`(^WHcAdpiq!?iwoOix%VbSQLwl76iedj$C3fP8ZtYxoJ1&E7wy><=l+xxjtW=^+-g>*oNtIeeNCZTi={{Wxugj_m_o@_`B{l692i|SU|pPAwQKw6Dv_&K@!b1-waZE>azZl6r!XXQ4Gd|{AejC4yThTdK6gosT{*a$i<BMLIu&vp^}=ijQUCyF^a3yy<eULrvaY-pgPN#M0`)@+QVF{$z?Ib3A~Cj52NmDxUP`Xd;$~XqTu|jD{33c&1Nc!A5>DN*Llc)H@+>#BOd0OO)kxIyoE}dU39kVA2Jb=PK~q;sXOX?=LcLfA9l^swYuRTm;qK<tLGnT<IQxU2Oe@5zzB+%!W@3$H<qx1b!=e=2ROnB&TxTCT;UowxWyf+xW@w?@x=RYkeDQ-Lw-oF_|h+fQjiImk$L$gi?S?hvMJlLD~EC{r}6@YI)<D",
    ),
    (
        "v.zarr.zip",
        "a chunk by another's name: that one was read, and fill values",
        "c-oCqF^CgE6n+1q9;OhK6D$Pd2o@5(i{?bM5G@1=$`*pi5tm7JlAF8DY?z%@lOv*qASj3k7J|irg`J()*x3mdb~a)sSlC$z7S8M@n@c2|f0+4y"
        "|DX5YpPfHmt*~POnH<K#*Bci+Yq>dZXLE7Mjd|?BejLOR976?Xa2}U%1=p~G1|+(;jk|b&$9RSp*u-nR!CSn?2Yke5e8D$-$4~si9~7uad+7jq"
        "6QsY_p1zwTtvJ#{bd-)$mCn&cx=bEjr<)`wq?r12pB~Z^dQLCt72!W+l62prPyFf};O1`Y>2s}5ti_SqD3(erUgcfE&X!i}N2zqGoT_T3mhD=1"
        "CJVUXzUieqSt6CGoMvgDxtgeTzpZ6pBO57-Dc(u<Y0*wXu346hH6zuM?L>1UBbD#Yb4(WE<YYNFt7CI{Xw_3au<Kw;CF`Q+3)PGQsoMWm6o?j2"
        "LbGi}vFLK^jkE(TvMHvP3`74G4-=PjDI<>p(Twxz^F$-!M$d?tmGcwNAhsc)0?D0^h0>T%uwiJB7m?ivH%7}w;?i1tR#+fALd7<v?|8@Mu>R=8"
        "y^(Q;<(XVR_^n8HxUq<|1DLYs$?x07c?M*${U^L_Lz=7DVT4X;>cxRqqq&8`><2cIdubaFJAWE9{XoW`WHxBJ!N;H<Tie~M?cC+u1v@sa_6zRo"
        "FWQIMTL",
    ),
)
"""Name, what happened, and content."""
